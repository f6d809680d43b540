// Data of the report, unpacked once; names used by all scripts of this page.
const $ = (id) => document.getElementById(id);
const KINDS = { Uint8: Uint8Array, Uint16: Uint16Array, Uint32: Uint32Array, Float32: Float32Array };

// What packing.py packed: base64 of deflated bytes; maybe all lowest bytes first, maybe differences.
async function unpacked({ type, data, apart, differences }) {
  const packed = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const raw = new Uint8Array(await new Response(stream).arrayBuffer());
  const values = new KINDS[type]((apart ? together(raw, KINDS[type].BYTES_PER_ELEMENT) : raw).buffer);
  return differences ? summed(values) : values;
}

function together(raw, size) {
  const found = new Uint8Array(raw.length);
  for (let byte = 0, from = 0; byte < size; byte++) {
    for (let to = byte; to < found.length; to += size) found[to] = raw[from++];
  }
  return found;
}

function summed(codes) {
  const values = new Uint32Array(codes.length);
  for (let at = 0, value = 0; at < codes.length; at++) {
    const code = codes[at];
    value += code % 2 ? -(code + 1) / 2 : code / 2;
    values[at] = value;
  }
  return values;
}

const isPacked = (value) => typeof value?.data === "string" && value.type in KINDS;

// The same data with every packed array in it unpacked.
async function decoded(value) {
  if (isPacked(value)) return unpacked(value);
  if (Array.isArray(value)) return Promise.all(value.map(decoded));
  if (value === null || typeof value !== "object") return value;
  const pairs = Object.entries(value).map(async ([name, each]) => [name, await decoded(each)]);
  return Object.fromEntries(await Promise.all(pairs));
}

if (typeof DecompressionStream === "undefined") {
  $("hint").textContent = "This browser cannot unpack the data of the report: it needs one of 2023 or later.";
  throw new Error("there is no DecompressionStream");
}
const REPORT = await decoded(JSON.parse($("data").textContent));
const OUTSIDE = REPORT.cells; // cells are their places in REPORT.order

// Four significant digits, whole numbers in full; what is missing is a dash.
function shown(value) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (Number.isInteger(value) || Math.abs(value) >= 1000) return Math.round(value).toLocaleString("en");
  return value.toPrecision(4);
}

const fixed = (digits) => (value) =>
  value === null || value === undefined || Number.isNaN(value) ? "–" : value.toFixed(digits);

// An element with attributes, and text or elements inside; text never becomes markup.
function element(tag, attributes = {}, ...content) {
  const svg = ["svg", "rect", "line", "circle", "path", "text"].includes(tag);
  const made = svg
    ? document.createElementNS("http://www.w3.org/2000/svg", tag)
    : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") made.addEventListener(name, value);
    else made.setAttribute(name, value);
  }
  made.append(...content);
  return made;
}
