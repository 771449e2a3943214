// Draws what the monitor knows: the grid on a canvas, stages and latency as SVG. No state but the last picture of the cells.

const SVG = "http://www.w3.org/2000/svg";

/** A colour of the style sheet, in the theme that is on. */
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

const rgb = (name) => {
  const hex = colour(name).replace("#", "");
  const full = hex.length === 3 ? [...hex].map((digit) => digit + digit).join("") : hex;
  return [0, 2, 4].map((at) => parseInt(full.slice(at, at + 2), 16));
};

/** A cell is free up to this occupancy. */
const FREE_AT_MOST = 35;
/** Ages of cells are told apart up to this, in 0.1 s. */
const OLD = 50;

export const LAYERS = {
  occupancy: [["free", "free"], ["occupied", "occupied"], ["unknown", "unknown"]],
  reason: [["free", "seen as road"], ["box", "box"], ["network", "seen, not road"], ["previous", "from before"], ["unknown", "unseen"]],
  age: [["car", "seen just now"], ["unknown", "5 s ago, or never"]],
};

/** Fills the legend of a layer. */
export function legend(list, layer) {
  list.replaceChildren(...[...LAYERS[layer], ["edge", "how far it is free"]].map(([name, text]) => {
    const item = document.createElement("li");
    const mark = document.createElement("i");
    mark.style.background = colour(name);
    item.append(mark, text);
    return item;
  }));
}

function colouring(layer) {
  const [free, occupied, unknown] = ["free", "occupied", "unknown"].map(rgb);
  if (layer === "reason") {
    const reasons = ["unknown", "free", "box", "network", "previous"].map(rgb);
    return (_, reason) => reasons[reason] ?? unknown;
  }
  if (layer === "age") {
    const fresh = rgb("car");
    return (_, __, age) => {
      const part = Math.min(age, OLD) / OLD;
      return fresh.map((value, i) => value * (1 - part) + unknown[i] * part);
    };
  }
  return (occupancy) => (occupancy < 0 ? unknown : occupancy <= FREE_AT_MOST ? free : occupied);
}

/** The cells as an image of one pixel each, ahead up and left to the left. */
function cellsImage(size, cells, layer) {
  const { rows, columns } = size;
  const count = rows * columns;
  if (count === 0 || cells.byteLength < 3 * count) return null;
  const occupancy = new Int8Array(cells, 0, count);
  const reason = new Uint8Array(cells, count, count);
  const age = new Uint8Array(cells, 2 * count, count);
  const image = new OffscreenCanvas(columns, rows);
  const context = image.getContext("2d");
  const pixels = context.createImageData(columns, rows);
  const of = colouring(layer);
  for (let cell = 0; cell < count; cell += 1) {
    const row = Math.floor(cell / columns);
    const at = 4 * ((rows - 1 - row) * columns + (columns - 1 - (cell % columns)));
    pixels.data.set([...of(occupancy[cell], reason[cell], age[cell]), 255], at);
  }
  context.putImageData(pixels, 0, 0);
  return image;
}

/** Metres shown behind the rear axle, so that the car is in the picture. */
const BEHIND_M = 1.5;
const CAR = { rear: -1.0, front: 3.6, half: 0.9 };

/** Draws the grid with rings each 10 m, the boundary and the car. */
export function grid(canvas, message, cells, layer, isLive) {
  const size = message.grid;
  const widthM = size.columns * size.cell_m;
  const heightM = size.rows * size.cell_m + size.origin_m[0] + BEHIND_M;
  const width = Math.max(1, Math.round(canvas.clientWidth * devicePixelRatio));
  const scale = width / widthM;
  canvas.width = width;
  canvas.height = Math.max(1, Math.round(heightM * scale));
  const context = canvas.getContext("2d");
  const place = (ahead, left) => [
    width - (left - size.origin_m[1]) * scale,
    canvas.height - (ahead + BEHIND_M) * scale,
  ];
  context.globalAlpha = isLive ? 1 : 0.35;
  const image = cells && cellsImage(size, cells, layer);
  if (image) {
    context.imageSmoothingEnabled = false;
    const [x, y] = place(size.origin_m[0] + size.rows * size.cell_m, size.origin_m[1] + widthM);
    context.drawImage(image, x, y, widthM * scale, size.rows * size.cell_m * scale);
  }
  rings(context, place, scale);
  boundary(context, place, message.boundary);
  context.fillStyle = colour("car");
  const [x, y] = place(CAR.front, CAR.half);
  context.beginPath();
  context.roundRect(x, y, 2 * CAR.half * scale, (CAR.front - CAR.rear) * scale, 0.4 * scale);
  context.fill();
}

function rings(context, place, scale) {
  const [x, y] = place(0, 0);
  context.lineWidth = devicePixelRatio;
  context.strokeStyle = context.fillStyle = colour("ring");
  context.font = `${12 * devicePixelRatio}px system-ui, sans-serif`;
  context.textAlign = "center";
  for (let radius = 10; radius <= 100 && radius * scale < y; radius += 10) {
    context.beginPath();
    context.setLineDash([4 * devicePixelRatio, 5 * devicePixelRatio]);
    context.arc(x, y, radius * scale, Math.PI, 2 * Math.PI);
    context.stroke();
    if (y - radius * scale < 10 * devicePixelRatio) break;
    const label = `${radius} m`;
    const half = context.measureText(label).width / 2 + 4 * devicePixelRatio;
    context.save();
    context.globalAlpha *= 0.8;
    context.fillStyle = colour("panel");
    context.fillRect(x - half, y - radius * scale - 8 * devicePixelRatio, 2 * half, 16 * devicePixelRatio);
    context.restore();
    context.fillStyle = colour("ink");
    context.fillText(label, x, y - radius * scale + 4 * devicePixelRatio);
  }
  context.setLineDash([]);
}

function boundary(context, place, { first_rad: first, sector_rad: width, free_m: free }) {
  context.strokeStyle = colour("edge");
  context.lineWidth = 2.5 * devicePixelRatio;
  context.lineJoin = "round";
  context.beginPath();
  free.forEach((metres, sector) => {
    for (const bearing of [first + sector * width, first + (sector + 1) * width]) {
      context.lineTo(...place(metres * Math.cos(bearing), metres * Math.sin(bearing)));
    }
  });
  context.stroke();
}

function node(name, attributes, text) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

/** An empty plot with its axis of milliseconds; gives its inner size and what adds to it. */
function plot(svg, left) {
  const { clientWidth: width, clientHeight: height } = svg;
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  svg.replaceChildren();
  return { width, height: height - 22, left, add: (...made) => svg.append(node(...made)) };
}

const nice = (most) => [10, 20, 25, 50, 100, 200, 250, 500, 1000].find((step) => most / step <= 5) ?? 2000;

/** Time of each stage for the last key frames, a bar each; an outline is the time from capture to publication. */
export function stages(svg, history, names, shown = 60) {
  const entries = history.slice(-shown);
  const { width, height, left, add } = plot(svg, 44);
  const sum = (entry) => (entry.stages_ms ?? []).reduce((total, ms) => total + ms, 0);
  const most = Math.max(40, ...entries.map((entry) => 1.12 * Math.max(entry.used_ms, sum(entry))));
  const y = (ms) => height - (ms / most) * (height - 6);
  for (let ms = 0; ms <= most; ms += nice(most)) {
    add("line", { class: "axis", x1: left, x2: width, y1: y(ms), y2: y(ms) });
    add("text", { x: left - 6, y: y(ms) + 4, "text-anchor": "end" }, ms);
  }
  add("text", { x: left - 6, y: height + 17, "text-anchor": "end" }, "ms");
  const step = (width - left) / shown;
  const bar = Math.max(1, step - Math.min(2, 0.25 * step));
  entries.forEach((entry, i) => {
    const x = left + (shown - entries.length + i) * step;
    let from = 0;
    (entry.stages_ms ?? []).forEach((ms, stage) => {
      add("rect", { class: `s${stage}`, x, width: bar, y: y(from + ms), height: Math.max(0, y(from) - y(from + ms)) });
      from += ms;
    });
    if (!entry.stages_ms) {
      add("rect", { class: "plain", x, width: bar, y: y(entry.used_ms), height: height - y(entry.used_ms) });
    }
    add("line", { class: "used", x1: x, x2: x + bar, y1: y(entry.used_ms), y2: y(entry.used_ms) });
    if (entry.is_miss) add("text", { class: "miss", x: x + bar / 2, y: 11, "text-anchor": "middle" }, "×");
  });
  const budget = entries.at(-1)?.budget_ms ?? 0;
  if (budget > 0 && budget <= most) limit(add, "y", y(budget), left, width, `deadline ${budget} ms`);
  else if (budget > 0) add("text", { x: width, y: height + 17, "text-anchor": "end" }, `deadline ${budget} ms, above the picture`);
  const slowest = names.map((name, stage) => [name, Math.max(0, ...entries.map((entry) => entry.stages_ms?.[stage] ?? 0))]);
  slowest.sort((a, b) => b[1] - a[1]);
  const said = slowest[0]?.[1] > 0 ? `; the longest stage was ${slowest[0][0]}, ${slowest[0][1].toFixed(0)} ms` : "";
  svg.setAttribute("aria-label", `Time in each stage for the last ${entries.length} key frames${said}`);
}

function limit(add, axis, at, from, to, text) {
  if (axis === "y") {
    add("line", { class: "limit", x1: from, x2: to, y1: at, y2: at });
    add("text", { class: "limit-text", x: to, y: at - 4, "text-anchor": "end" }, text);
  } else {
    add("line", { class: "limit", x1: at, x2: at, y1: from, y2: to });
    add("text", { class: "limit-text", x: at - 5, y: from + 10, "text-anchor": "end" }, text);
  }
}

/** How often each time from capture to publication was seen, against the deadline. */
export function latency(svg, { bins, bin_ms: width_ms, percentiles }, budget) {
  const { width, height, left, add } = plot(svg, 8);
  const most = Math.max(1, ...bins);
  const x = (ms) => left + (ms / (width_ms * bins.length)) * (width - left);
  for (let ms = 0; ms <= width_ms * (bins.length - 1); ms += 100) {
    add("line", { class: "axis", x1: x(ms), x2: x(ms), y1: 0, y2: height });
    add("text", { x: x(ms), y: height + 17, "text-anchor": ms === 0 ? "start" : "middle" }, ms === 0 ? "0 ms" : ms);
  }
  bins.forEach((count, i) => {
    if (count === 0) return;
    const high = Math.max(2, (count / most) * (height - 16));
    const kind = i * width_ms >= budget ? "bar late" : "bar";
    add("rect", { class: kind, x: x(i * width_ms) + 0.5, width: Math.max(1, x(width_ms) - left - 1), y: height - high, height: high });
  });
  limit(add, "x", x(budget), 0, height, `deadline ${budget} ms`);
  const said = percentiles ? `median ${percentiles.p50.toFixed(0)} ms, largest ${percentiles.max.toFixed(0)} ms` : "no sample yet";
  svg.setAttribute("aria-label", `Times from capture to publication against the deadline of ${budget} ms: ${said}`);
}
