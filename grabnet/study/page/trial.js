"use strict";

// An element with attributes and children; text is never read as HTML.
function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

function film(name, size, label) {
  return element("video", {
    src: `videos/${name}.mp4`, poster: `posters/${name}.jpg`, width: size, height: size,
    muted: "", playsinline: "", autoplay: "", preload: "auto", "aria-label": label,
  });
}

// jsPsych plugin: one video, or two, then an answer that is possible once all have been seen to their end.
class GraspTrial {
  static info = {
    name: "grasp-trial",
    version: "1.0.0",
    parameters: {
      videos: { type: jsPsychModule.ParameterType.STRING, array: true, default: undefined },
      next: { type: jsPsychModule.ParameterType.STRING, array: true, default: [] },
      statement: { type: jsPsychModule.ParameterType.STRING, default: undefined },
      levels: { type: jsPsychModule.ParameterType.STRING, array: true, default: undefined },
      number: { type: jsPsychModule.ParameterType.INT, default: undefined },
      total: { type: jsPsychModule.ParameterType.INT, default: undefined },
      size: { type: jsPsychModule.ParameterType.INT, default: undefined },
    },
    data: {
      videos: { type: jsPsychModule.ParameterType.STRING, array: true },
      answer: { type: jsPsychModule.ParameterType.INT },
      seconds: { type: jsPsychModule.ParameterType.FLOAT },
    },
  };

  constructor(jsPsych) {
    this.jsPsych = jsPsych;
  }

  trial(display, trial) {
    const start = performance.now();
    const paired = trial.videos.length > 1;
    const what = paired ? "Pair" : "Video";
    const count = `${what} ${trial.number} of ${trial.total}`;
    const statement = element("p", { class: "statement", id: "statement", tabindex: "-1" }, trial.statement);
    const seen = element("p", { class: "seen", role: "status" }, `Please watch the ${paired ? "videos" : "video"} first.`);
    const films = trial.videos.map((name, k) =>
      film(name, trial.size, paired ? `${trial.levels[k]}: a hand on an object, turning` : "A hand on an object, turning"));
    const buttons = trial.levels.map((level, k) =>
      element("button", { type: "button", disabled: "" }, element("b", {}, `${k + 1}`), ` ${level}`));
    display.replaceChildren(
      element("div", { class: "progress" }, element("span", {}, count),
        element("progress", { max: trial.total, value: trial.number - 1, "aria-label": count })),
      element("div", { class: "videos" }, ...films.map((video, k) =>
        element("figure", {}, video, ...(paired ? [element("figcaption", {}, trial.levels[k])] : [])))),
      statement,
      element("div", { class: paired ? "levels two" : "levels", role: "group", "aria-labelledby": "statement" }, ...buttons),
      seen,
    );
    const ahead = trial.next.map((name) => film(name, trial.size, ""));
    ahead.forEach((video) => video.removeAttribute("autoplay"));

    let open = false;
    const waiting = new Set(films);
    const answer = (level) => {
      if (!open) return;
      open = false;
      this.jsPsych.pluginAPI.cancelAllKeyboardResponses();
      films.forEach((video) => video.pause());
      const seconds = Math.round(performance.now() - start) / 1000;
      this.jsPsych.finishTrial({ videos: trial.videos, answer: level, seconds });
    };
    const ended = (video) => {
      waiting.delete(video);
      video.loop = true;
      play(video);
      if (waiting.size || open) return;
      open = true;
      buttons.forEach((button) => button.removeAttribute("disabled"));
      seen.textContent = `You can answer now: click, or press a key, 1 to ${trial.levels.length}.`;
    };
    const offer = (video, text, action) => {
      if (display.querySelector(".problem")) return;
      const button = element("button", { type: "button" }, text);
      const box = element("p", { class: "problem", role: "alert" }, button);
      button.addEventListener("click", () => (box.remove(), action(video)));
      seen.before(box);
    };
    const play = (video) => video.play().catch((error) => {
      if (error.name === "NotAllowedError") offer(video, "Play the video", () => films.forEach(play));
    });
    for (const video of films) {
      video.muted = true; // browsers play by themselves what has no sound; the attribute counts only in a page's source
      video.addEventListener("ended", () => ended(video), { once: true });
      video.addEventListener("error", () => offer(video, "The video did not load. Try again", () => {
        films.forEach((v) => v.error && (v.load(), play(v)));
      }));
      play(video);
    }
    buttons.forEach((button, k) => button.addEventListener("click", () => answer(k + 1)));
    this.jsPsych.pluginAPI.getKeyboardResponse({
      callback_function: ({ key }) => answer(Number(key)),
      valid_responses: trial.levels.map((_, k) => `${k + 1}`),
      persist: true,
      allow_held_key: false,
    });
    statement.focus({ preventScroll: true });
    scrollTo(0, 0);
  }
}
