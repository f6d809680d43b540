// Data of the report, decoded once; names used by all scripts of this page.
const $ = (id) => document.getElementById(id);

function unpacked({ type, data }) {
  const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
  const kinds = { Uint8: Uint8Array, Uint16: Uint16Array, Uint32: Uint32Array, Float32: Float32Array };
  return new kinds[type](bytes.buffer);
}

function decoded(report) {
  for (const name of ["points", "faces", "sides"]) if (report[name]) report[name] = unpacked(report[name]);
  for (const run of report.runs) {
    for (const level of run.levels) {
      level.labels = unpacked(level.labels);
      level.colours = unpacked(level.colours);
      for (const name of Object.keys(level.values)) level.values[name] = unpacked(level.values[name]);
    }
  }
  return report;
}

const REPORT = decoded(JSON.parse($("data").textContent));
const OUTSIDE = REPORT.cells;

// Four significant digits, whole numbers in full; what is missing is a dash.
function shown(value) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (Number.isInteger(value) || Math.abs(value) >= 1000) return Math.round(value).toLocaleString("en");
  return value.toPrecision(4);
}

const fixed = (digits) => (value) => (value === null || value === undefined ? "–" : value.toFixed(digits));

// An element with attributes, and text or elements inside; text never becomes markup.
function element(tag, attributes = {}, ...content) {
  const svg = ["svg", "rect", "line", "circle", "path", "text"].includes(tag);
  const made = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") made.addEventListener(name, value);
    else made.setAttribute(name, value);
  }
  made.append(...content);
  return made;
}
