// Polls the state and shows it. Everything that comes is put in as text, never as markup.

import * as draw from "./draw.js";

/** A key frame comes each half second. */
const EVERY_MS = 300;
const WAIT_MS = 3000;

const id = (name) => document.getElementById(name);
const words = (name) => name.replaceAll("_", " ");

const shown = { state: null, cells: null, gridOf: null, pictureOf: null, layer: "occupancy", isPaused: false };

function text(element, value) {
  if (element.textContent !== value) element.textContent = value;
}

/** Fills a list of terms; what is there already is left alone, so that a reader of the screen is not interrupted. */
function terms(list, facts) {
  facts.forEach(([name, value, kind = ""], i) => {
    let pair = list.children[i];
    if (!pair) {
      pair = document.createElement("div");
      pair.append(document.createElement("dt"), document.createElement("dd"));
      list.append(pair);
    }
    text(pair.firstChild, name);
    text(pair.lastChild, value);
    pair.lastChild.className = kind;
  });
  while (list.children.length > facts.length) list.lastChild.remove();
}

const among = (value, good) => (good.includes(value) ? "" : "warn");

function facts(state) {
  const { message, latency, totals, module } = state;
  const { percentiles: times } = latency;
  const list = [
    ["free ahead", `${message.free_ahead_m.toFixed(1)} m`],
    ["speed", `${(3.6 * message.speed_mps).toFixed(0)} km/h`],
    ["this key frame", `${message.used_ms.toFixed(0)} ms`, message.used_ms > message.budget_ms ? "bad" : ""],
    ["p99 to publication", times ? `${times.p99.toFixed(0)} ms` : "-", times?.p99 > message.budget_ms ? "bad" : ""],
    ["deadline misses", String(totals.misses), totals.misses > 0 ? "bad" : "good"],
    ["scale from", words(message.scale), among(message.scale, ["wheels", "camera_height"])],
    ["tracking", words(message.tracking), among(message.tracking, ["good", "standstill"])],
    ["camera", message.camera, among(message.camera, ["good"])],
    ["wheels", message.wheels, among(message.wheels, ["good", "not used"])],
    ["CAN out", message.can, among(message.can, ["no fault"])],
  ];
  if (module) list.push(["frames dropped", String(module.dropped_frames), module.dropped_frames > 0 ? "warn" : ""]);
  return list;
}

const counted = (counts) => counts.map(({ name, count }) => `${words(name)} ${count}`).join(", ") || "none";

/** The warmest sensors first, and what is to be said of the others. */
function warmth(temperatures, note) {
  const warmest = [...temperatures].sort((a, b) => b.celsius - a.celsius);
  return [...warmest.map(({ zone, celsius }) => `${zone} ${celsius.toFixed(1)} \u00b0C`), ...(note ? [note] : [])].join(", ");
}

function counts({ totals, module, message, temperatures, temperature_note: note }) {
  const list = [
    ["messages", `${totals.messages} since the monitor started, ${totals.lost} lost`],
    ["levels", counted(totals.levels)],
    ["faults", counted(totals.faults)],
    ["faults now", message.faults.map(words).join(", ") || "none"],
    ["starts seen", String(totals.starts)],
    ["camera height", `${message.camera_height_m.toFixed(2)} m, ${message.plane_inliers} landmarks on the plane`],
  ];
  list.push(["temperatures", warmth(temperatures, note)]);
  if (module) {
    list.push(["module", `${module.key_frames} key frames, ${module.deadline_misses} misses, ${module.restarts} restarts`]);
    list.push(["map", `${module.landmarks} landmarks, ${module.boxes} boxes`]);
  }
  return list;
}

function list(element, lines) {
  if (element.textContent === lines.join("")) return;
  element.replaceChildren(...lines.map((line) => {
    const item = document.createElement("li");
    item.textContent = line;
    return item;
  }));
}

function misses(body, entries) {
  const key = entries.map((entry) => entry.sequence).join();
  if (body.dataset.key === key) return;
  body.dataset.key = key;
  id("miss-table").hidden = entries.length === 0;
  body.replaceChildren(...entries.map((entry) => {
    const row = document.createElement("tr");
    const cells = [entry.sequence, new Date(entry.unix_ms).toLocaleTimeString(), entry.used_ms.toFixed(0), words(entry.level), entry.blame ?? "-", entry.faults.map(words).join(", ")];
    row.append(...cells.map((value) => {
      const cell = document.createElement("td");
      cell.textContent = value;
      return cell;
    }));
    return row;
  }));
}

const LINKS = { live: ["live", "good"], silent: ["silent", "bad"], ended: ["ended", "bad"], waiting: ["waiting", "warn"] };

function pill(element, value, kind) {
  element.hidden = false;
  element.className = `pill ${kind}`;
  text(element, value);
}

function alarm(value) {
  id("alert").hidden = !value;
  text(id("alert"), value ?? "");
}

function drawAll() {
  const { state, cells, layer } = shown;
  if (!state?.message) return;
  draw.grid(id("grid"), state.message, cells, layer, state.link === "live");
  draw.stages(id("stages"), state.history, state.stages);
  draw.latency(id("latency"), state.latency, state.message.budget_ms);
}

function show(state) {
  shown.state = state;
  text(id("service"), state.service);
  const [name, kind] = LINKS[state.link];
  const isLive = state.link === "live";
  document.body.classList.toggle("stale", !isLive);
  document.title = `${isLive ? words(state.message.level) : name} - freespace monitor`;
  pill(id("link"), name, kind);
  const since = state.silent_s === null ? "" : ` The last message is ${state.silent_s.toFixed(0)} s old.`;
  alarm(state.reason ? `${state.reason}.${since}` : state.link === "ended" ? `The module has ended.${since}` : null);
  const { message } = state;
  if (!message) return;
  pill(id("level"), words(message.level), message.level_number === 0 ? "good" : message.level_number < 4 ? "warn" : "bad");
  id("level").hidden = !isLive;
  terms(id("facts"), facts(state));
  list(id("events"), state.module?.events.length ? state.module.events : ["nothing"]);
  text(id("blames"), `Since the monitor started: ${state.totals.misses}. By stage: ${counted(state.totals.misses_by_blame)}.`);
  misses(id("misses"), state.misses);
  const times = state.latency.percentiles;
  text(id("percentiles"), times ? `median ${times.p50.toFixed(1)}, p99 ${times.p99.toFixed(1)}, p99.9 ${times.p99_9.toFixed(1)}, largest ${times.max.toFixed(1)} ms of ${state.latency.count} key frames` : "");
  const seen = id("counts");
  const flat = counts(state).flatMap(([term, value]) => [["dt", term], ["dd", value]]);
  flat.forEach(([tag, value], i) => {
    const child = seen.children[i] ?? seen.appendChild(document.createElement(tag));
    text(child, value);
  });
  const free = message.free_ahead_m.toFixed(1);
  id("grid").setAttribute("aria-label", `Grid from above, coloured by ${shown.layer}: ${free} m free straight ahead, level ${words(message.level)}`);
}

async function fetchCells({ message }) {
  if (!message || shown.gridOf === message.sequence) return;
  const answer = await fetch("/api/grid", { signal: AbortSignal.timeout(WAIT_MS) });
  if (!answer.ok) return;
  const of = Number(answer.headers.get("freespace-sequence"));
  shown.cells = await answer.arrayBuffer();
  shown.gridOf = of;
}

/** The picture under its own number: one that the last messages came without is dimmed, and said to be old. */
function showPicture({ has_picture: isThere, picture_sequence: of, module, message, stages }) {
  const image = id("picture");
  image.hidden = !isThere;
  id("no-picture").hidden = isThere;
  if (!isThere) {
    shown.pictureOf = null;
    text(id("picture-note"), "");
    return;
  }
  if (shown.pictureOf !== of) {
    shown.pictureOf = of;
    image.src = `/api/picture?of=${of}`;
  }
  // A picture comes a moment after its message: one message behind is no fault yet.
  const isOld = of !== module.sequence || message.sequence > of + 1;
  image.classList.toggle("old", isOld);
  const times = stages.map((name, i) => [name, module.stage_micros[i] / 1000]).filter(([, ms]) => ms >= 0.05);
  const spent = times.map(([name, ms]) => `${name} ${ms.toFixed(1)}`).join(", ");
  text(id("picture-note"), isOld ? `OLD picture, of key frame ${of}: key frame ${message.sequence} came without` : `key frame ${of}: ${spent} ms`);
}

async function poll() {
  if (shown.isPaused || document.hidden) return;
  try {
    const answer = await fetch("/api/state", { signal: AbortSignal.timeout(WAIT_MS) });
    if (!answer.ok) throw new Error(String(answer.status));
    const state = await answer.json();
    await fetchCells(state);
    // Pressed while the answer was under way: a paused page stays as it is, and says so.
    if (shown.isPaused) return;
    show(state);
    showPicture(state);
    drawAll();
  } catch {
    pill(id("link"), "monitor gone", "bad");
    id("level").hidden = true;
    document.body.classList.add("stale");
    alarm("The monitor does not answer: what is shown is old. Start freespace monitor again.");
  }
}

async function forever() {
  await poll();
  setTimeout(forever, EVERY_MS);
}

function stageLegend() {
  const names = ["frame", "track", "map", "priors", "segmentation", "crf", "grid", "emit"];
  id("stage-legend").replaceChildren(...names.map((name, stage) => {
    const item = document.createElement("li");
    const mark = document.createElement("i");
    mark.className = `s${stage}`;
    item.append(mark, name);
    return item;
  }));
}

for (const input of document.querySelectorAll("input[name=layer]")) {
  input.addEventListener("change", () => {
    shown.layer = input.value;
    draw.legend(id("legend"), shown.layer);
    drawAll();
  });
}
id("pause").addEventListener("click", () => {
  shown.isPaused = !shown.isPaused;
  id("pause").setAttribute("aria-pressed", String(shown.isPaused));
  text(id("pause"), shown.isPaused ? "Paused" : "Pause");
  if (shown.isPaused) pill(id("link"), "paused", "warn");
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  draw.legend(id("legend"), shown.layer);
  drawAll();
});
new ResizeObserver(drawAll).observe(id("main"));
draw.legend(id("legend"), shown.layer);
stageLegend();
forever();
