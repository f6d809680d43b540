// Box plots.
const NAMES = 9.5; // least width of the names, in rem
const COLUMN = 7; // and of a metric
const LETTERS = 9; // most letters of three numbers below such a column
const METRICS = REPORT.metrics; // {name, low, high}: the ends of their axes

// Quartiles by linear interpolation, whiskers to the last value within 1.5 boxes, the rest outliers.
function boxOf(values) {
  const sorted = Float32Array.from(values).sort();
  const at = (share) => {
    const place = share * (sorted.length - 1),
      low = Math.floor(place);
    return sorted[low] + (place - low) * ((sorted[low + 1] ?? sorted[low]) - sorted[low]);
  };
  const [q1, median, q3] = [at(0.25), at(0.5), at(0.75)];
  const reach = 1.5 * (q3 - q1);
  const inside = sorted.filter((value) => value >= q1 - reach && value <= q3 + reach);
  const outliers = sorted.filter((value) => value < q1 - reach || value > q3 + reach);
  const mean = sorted.reduce((sum, value) => sum + value, 0) / sorted.length;
  return { q1, median, q3, low: inside[0], high: inside[inside.length - 1], outliers, mean };
}

function boxesOf(level) {
  const measured = METRICS.filter(({ name }) => level.values[name]);
  level.boxes ??= Object.fromEntries(
    measured.map(({ name }) => [name, boxOf(level.values[name].filter(Number.isFinite))]),
  );
  return level.boxes;
}

const percent = (value) => `${(100 * value).toFixed(2)}%`;

function boxGlyph(values, { low, high }, colour, part) {
  const middle = 13,
    place = (value) => (value - low) / (high - low);
  const b = Object.fromEntries(
    Object.entries(values).map(([key, value]) => [key, key === "outliers" ? value.map(place) : place(value)]),
  );
  const line = (x1, x2, y1, y2, width = 1) =>
    element("line", { class: "ink", x1: percent(x1), x2: percent(x2), y1, y2, "stroke-width": width });
  const label = `median ${values.median.toFixed(3)}, quartiles ${values.q1.toFixed(3)} and ${values.q3.toFixed(3)}, mean ${values.mean.toFixed(3)}`;
  const glyph = element("svg", { role: "img", "aria-label": label });
  for (const tick of [0, 0.25, 0.5, 0.75, 1]) {
    glyph.append(element("line", { x1: percent(tick), x2: percent(tick), y1: -3, y2: 29, class: "grid" }));
  }
  for (const value of b.outliers)
    glyph.append(element("circle", { cx: percent(value), cy: middle, r: 1.6, class: "outlier" }));
  glyph.append(
    line(b.low, b.q1, middle, middle),
    line(b.q3, b.high, middle, middle),
    line(b.low, b.low, 8, 18),
    line(b.high, b.high, 8, 18),
    element("rect", {
      x: percent(b.q1),
      width: percent(b.q3 - b.q1),
      y: 4,
      height: 18,
      fill: colour,
      class: "ink",
    }),
    element("line", { class: "median", x1: percent(b.median), x2: percent(b.median), y1: 4, y2: 22 }),
    element("circle", { cx: percent(b.mean), cy: middle, r: 3, class: "mean" }),
  );
  const marked = place(part);
  if (Number.isFinite(marked))
    glyph.append(
      element("line", { x1: percent(marked), x2: percent(marked), y1: 0, y2: 26, class: "marked" }),
    );
  return glyph;
}

function axisGlyph({ low, high }) {
  const glyph = element("svg", { "aria-hidden": "true" });
  const number = (tick) => String(Number((low + tick * (high - low)).toPrecision(3)));
  const room = [0, 0.5, 1].map(number).join("").length <= LETTERS;
  for (const tick of room ? [0, 0.5, 1] : [0, 1]) {
    const anchor = tick === 0 ? "start" : tick === 1 ? "end" : "middle";
    glyph.append(element("text", { x: percent(tick), y: 12, "text-anchor": anchor }, number(tick)));
  }
  return glyph;
}

// One row a run, one column a metric, at the given level of each; ``chosen`` tells the agglomerate of a run.
function boxTable(table, place, chosen) {
  const head = element(
    "tr",
    {},
    element("th", { scope: "col" }, "run"),
    ...METRICS.map(({ name }) => element("th", { scope: "col" }, name)),
  );
  const body = element("tbody");
  REPORT.runs.forEach((run, index) => {
    const level = run.levels[Math.min(place, run.levels.length - 1)];
    if (!level) return;
    const colour = REPORT.palette[index % REPORT.palette.length];
    const cells = METRICS.map((metric) => {
      const values = boxesOf(level)[metric.name];
      const part = chosen.get(index) ?? null;
      const marked = part !== null ? level.values[metric.name]?.[part] : undefined;
      const missing = level.undefined?.[metric.name];
      const note = missing ? [element("small", {}, `${missing} undefined`)] : [];
      return element(
        "td",
        {},
        values && Number.isFinite(values.median) ? boxGlyph(values, metric, colour, marked) : "–",
        ...note,
      );
    });
    body.append(
      element(
        "tr",
        chosen.has(index) ? { class: "chosen" } : {},
        element("th", { scope: "row" }, run.name),
        ...cells,
      ),
    );
  });
  const foot = element(
    "tr",
    {},
    element("th"),
    ...METRICS.map((metric) => element("td", {}, axisGlyph(metric))),
  );
  table.style.minWidth = `${NAMES + COLUMN * METRICS.length}rem`;
  table.replaceChildren(element("thead", {}, head), body, element("tfoot", {}, foot));
}
