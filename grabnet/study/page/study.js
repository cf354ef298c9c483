"use strict";

// The study from first page to stored answers.

function show(...children) {
  document.getElementById("study").replaceChildren(element("div", { class: "jspsych-content" }, ...children));
}

function page(title, paragraphs, ...more) {
  const box = element("div", {}, element("h1", {}, title), ...paragraphs.map((text) => element("p", { class: "text" }, text)));
  box.append(...more);
  return box.outerHTML;
}

function welcome(study, place) {
  const examples = element("div", { class: "videos" }, ...study.examples.map(({ video, text }) => {
    const example = film(video, study.size, text);
    example.setAttribute("loop", "");
    return element("figure", {}, example, element("figcaption", {}, text));
  }));
  const levels = element("p", { class: "text" }, study.kind === "paired" ? `You choose: ${study.levels.join(" or ")}.` :
    `Your answer, from 1 to ${study.levels.length}: ${study.levels.map((level, k) => `${k + 1} ${level}`).join(", ")}.`);
  const number = element("p", { class: "text" }, `There are ${place.state.order.length} ${study.kind === "paired" ? "pairs" : "videos"}.`);
  const statement = element("p", { class: "statement" }, study.statement);
  const screen = (stimulus, choice) => ({
    type: jsPsychHtmlButtonResponse,
    stimulus,
    choices: [choice],
    on_load: () => document.querySelectorAll("video").forEach((video) => {
      video.muted = true;
      video.play().catch(() => video.setAttribute("controls", ""));
    }),
  });
  return [
    { ...screen(page(study.title, study.consent), "I agree"), on_finish: () => {
      place.state.consented = true;
      place.save();
    } },
    screen(page("What to do", study.instructions, statement, levels, number, examples), "Begin"),
  ];
}

function trials(study, place) {
  const { order, answers } = place.state;
  return order.slice(answers.length).map((videos, k) => ({
    type: GraspTrial,
    videos,
    next: order[answers.length + k + 1] || [],
    statement: study.statement,
    levels: study.levels,
    size: study.size,
    number: answers.length + k + 1,
    total: order.length,
    on_finish: (data) => {
      place.state.answers.push({ videos: data.videos, answer: data.answer, seconds: data.seconds });
      place.save();
    },
  }));
}

async function finish(study, place, ids) {
  const { session, list, answers } = place.state;
  const record = { study: study.study, session, list, platform: ids, answers };
  if (!place.state.stored) {
    show(element("p", { role: "status" }, "Your answers are being sent …"));
    const answer = await post("answers", record, 5);
    if (!answer || answer.stored !== session) return offerDownload(study, place, ids, record);
    place.state.stored = true;
    place.save();
  }
  const done = [element("h1", {}, study.title), element("p", { role: "status" }, study.thanks)];
  if (study.completion) done.push(element("p", { class: "buttons" },
    element("a", { class: "button", href: study.completion }, "Complete the study")));
  else if (!Object.keys(ids).length) {
    const again = element("button", { type: "button" }, "Begin as another person");
    again.addEventListener("click", () => (place.forget(), location.reload()));
    done.push(element("p", { class: "buttons" }, again));
  }
  show(...done);
  if (study.completion) location.assign(study.completion);
}

function offerDownload(study, place, ids, record) {
  const again = element("button", { type: "button" }, "Send again");
  const save = element("button", { type: "button" }, "Download");
  again.addEventListener("click", () => finish(study, place, ids));
  save.addEventListener("click", () => {
    const address = URL.createObjectURL(new Blob([JSON.stringify(record) + "\n"], { type: "application/json" }));
    element("a", { href: address, download: `answers-${record.session}.json` }).click();
    setTimeout(() => URL.revokeObjectURL(address), 10000);
  });
  show(element("h1", {}, study.title),
    element("p", { class: "problem", role: "alert" },
      "Your answers could not be sent. They are kept in this browser. Try again, or download them and send the file to the people who asked you."),
    element("p", { class: "buttons" }, again, save));
}

async function begin() {
  const study = await (await fetch("study.json")).json();
  document.title = study.title;
  const ids = platformIds();
  const place = new Place(study, ids);
  const { state } = place;
  const jsPsych = initJsPsych({ display_element: "study", on_finish: () => finish(study, place, ids) });
  if (!state.order.length) {
    const given = await post("assignment", { study: study.study, session: state.session });
    state.list = given ? given.list : Math.floor(Math.random() * study.lists.length);
    state.order = jsPsych.randomization.shuffle(study.lists[state.list].map((t) => jsPsych.randomization.shuffle(t)));
    place.save();
  }
  if (state.answers.length >= state.order.length) return finish(study, place, ids);
  await jsPsych.run([...(state.consented ? [] : welcome(study, place)), ...trials(study, place)]);
}

begin().catch(() => show(element("p", { class: "problem", role: "alert" },
  "The study could not be loaded. Please reload this page.")));
