// Colours of cells: by agglomerate, by a value of it, by a tag; and the legend that explains them.
const SCALE = [
  "#440154",
  "#472d7b",
  "#3b528b",
  "#2c728e",
  "#21918c",
  "#28ae80",
  "#5ec962",
  "#addc30",
  "#fde725",
]; // viridis
const UNDEFINED = "#bbbbbb",
  STEPS = 256;
const LENGTHS = ["diameter", "max_diameter"];

const channels = (tone) => [1, 3, 5].map((at) => Number.parseInt(tone.slice(at, at + 2), 16));
const packedTone = (red, green, blue) => ((255 << 24) | (blue << 16) | (green << 8) | red) >>> 0; // as bytes: r g b a

const PARTS = REPORT.palette.map((tone) => packedTone(...channels(tone)));
const NUMBERS = Array.from({ length: STEPS }, (_, step) => {
  const place = (step / (STEPS - 1)) * (SCALE.length - 1),
    low = Math.min(Math.floor(place), SCALE.length - 2);
  const [from, to] = [channels(SCALE[low]), channels(SCALE[low + 1])];
  return packedTone(...from.map((value, k) => Math.round(value + (place - low) * (to[k] - value))));
});

// What may be chosen: {key, name, unit, tag or value}. Values are those that any level has.
function choices() {
  const levels = REPORT.runs.flatMap((run) => run.levels);
  const names = [...new Set(levels.flatMap((level) => Object.keys(level.values)))];
  const unit = (name) =>
    LENGTHS.includes(name)
      ? "length, in units of the mesh"
      : name === "measure"
        ? `${REPORT.size}, in units of the mesh`
        : "";
  return [
    { key: "part", name: "agglomerate" },
    ...names.map((name) => ({
      key: `value:${name}`,
      name: name === "measure" ? REPORT.size : name,
      value: name,
      unit: unit(name),
    })),
    ...REPORT.tags.map((tag) => ({ key: `tag:${tag.name}`, name: tag.name, tag })),
  ];
}

// Least and largest finite number of several arrays, and whether any is undefined.
function range(arrays) {
  let low = Infinity,
    high = -Infinity,
    holes = false;
  for (const values of arrays) {
    for (const value of values) {
      if (!Number.isFinite(value)) {
        holes = true;
        continue;
      }
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  return { low, high, holes };
}

const isFlat = ({ low, high }) => !(high - low > 1e-6 * Math.max(Math.abs(low), Math.abs(high))); // but for rounding
const rangeOf = ({ value, tag }, levels) =>
  range(tag ? [tag.cells] : levels.map((level) => level?.values[value] ?? []));

function onScale(values, limits) {
  const { low, high } = limits,
    rate = isFlat(limits) ? 0 : (STEPS - 1) / (high - low),
    undefinedTone = packedTone(...channels(UNDEFINED));
  return Uint32Array.from(values, (value) =>
    Number.isFinite(value) ? NUMBERS[Math.round((value - low) * rate)] : undefinedTone,
  );
}

// Colour of each cell as bytes r g b a, and of the outside, which is clear.
function tintsOf(choice, level, limits) {
  const tints = new Uint32Array(REPORT.cells + 1);
  if (choice.tag) {
    const { known, cells } = choice.tag;
    tints.set(known ? Uint32Array.from(cells, (place) => PARTS[place]) : onScale(cells, limits));
    return tints;
  }
  const values = level?.values[choice.value];
  if (!level || (choice.value && !values))
    return tints.fill(packedTone(...channels(toneOf("--cells"))), 0, REPORT.cells);
  const tones = choice.value
    ? onScale(values, limits)
    : Uint32Array.from(level.colours, (colour) => PARTS[colour]);
  level.labels.forEach((part, cell) => {
    tints[cell] = tones[part];
  });
  return tints;
}

function swatch(tone, name) {
  const sample = element("i", { "aria-hidden": "true" });
  sample.style.background = tone;
  return element("span", {}, sample, name);
}

function showLegend(place, choice, limits) {
  const title = element("b", {}, choice.name),
    shade = REPORT.stills ? "darker in the shade" : "";
  const note = [choice.unit, shade].filter(Boolean).map((words) => element("span", {}, words));
  if (choice.key === "part") return place.replaceChildren("Colours only tell neighbours apart.");
  if (choice.tag?.known)
    return place.replaceChildren(
      title,
      ...choice.tag.known.map((name, at) => swatch(REPORT.palette[at], name)),
      ...note,
    );
  if (!(limits.low <= limits.high))
    return place.replaceChildren(title, "No agglomerate shown here has a value.");
  const bar = element("i", {
    class: "bar",
    role: "img",
    "aria-label": `from ${shown(limits.low)} (dark blue) to ${shown(limits.high)} (yellow)`,
  });
  bar.style.background = `linear-gradient(to right, ${SCALE.join(", ")})`;
  const one = isFlat(limits);
  const numbers = one ? [shown(limits.low)] : [shown(limits.low), bar, shown(limits.high)];
  const middle = one ? [] : [element("span", {}, `middle ${shown((limits.low + limits.high) / 2)}`)];
  const holes = limits.holes ? [swatch(UNDEFINED, "undefined")] : [];
  return place.replaceChildren(
    title,
    element("span", { class: "scale" }, ...numbers),
    ...middle,
    ...note,
    ...holes,
  );
}
