"use strict";

// A rater's place in the study, kept by the browser so that a reload loses nothing, and the way to the server.

const PLATFORM_IDS = ["PROLIFIC_PID", "STUDY_ID", "SESSION_ID"];

// The recruiting platform's ids, from this page's address; anything that does not look like one is left out.
function platformIds() {
  const given = new URLSearchParams(location.search);
  const known = PLATFORM_IDS.filter((name) => /^[A-Za-z0-9_-]{1,64}$/.test(given.get(name) || ""));
  return Object.fromEntries(known.map((name) => [name, given.get(name)]));
}

class Place {
  // study: as in study.json. ids: of the platform, which tell raters of one browser apart.
  constructor(study, ids) {
    this.name = `grabnet-study-${study.study}-${ids.PROLIFIC_PID || ""}-${ids.SESSION_ID || ""}`;
    this.state = this.read() || { session: randomHex(), consented: false, list: null, order: [], answers: [], stored: false };
  }

  read() {
    try {
      return JSON.parse(localStorage.getItem(this.name));
    } catch {
      return null;
    }
  }

  save() {
    try {
      localStorage.setItem(this.name, JSON.stringify(this.state));
    } catch {
      // A browser that keeps nothing: the study works, but a reload begins it again.
    }
  }

  forget() {
    try {
      localStorage.removeItem(this.name);
    } catch {}
  }
}

function randomHex() {
  return Array.from(crypto.getRandomValues(new Uint8Array(16)), (b) => b.toString(16).padStart(2, "0")).join("");
}

// What the server answers to a value, or null where there is none, as on a plain file server, or it refuses.
async function post(path, value, tries = 1) {
  for (let k = 0; k < tries; k++) {
    if (k) await new Promise((r) => setTimeout(r, 500 * 2 ** k));
    try {
      const answer = await fetch(path, {
        method: "POST",
        headers: { "Content-Type": "application/json" },
        body: JSON.stringify(value),
      });
      if (answer.ok) return await answer.json();
      if (answer.status < 500 && answer.status !== 429) return null;
    } catch {
      // No connection just now.
    }
  }
  return null;
}
