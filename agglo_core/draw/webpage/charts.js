// Box plots and sortable tables.
const METRICS = REPORT.metrics; // {name, low, high}: the ends of their axes

// Quartiles by linear interpolation, whiskers to the last value within 1.5 boxes, the rest outliers.
function boxOf(values) {
  const sorted = Float32Array.from(values).sort();
  const at = (share) => {
    const place = share * (sorted.length - 1), low = Math.floor(place);
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
  level.boxes ??= Object.fromEntries(measured.map(({ name }) => [name, boxOf(level.values[name].filter(Number.isFinite))]));
  return level.boxes;
}

const percent = (value) => `${(100 * value).toFixed(2)}%`;

function boxGlyph(values, { low, high }, colour, part) {
  const middle = 13, place = (value) => (value - low) / (high - low);
  const b = Object.fromEntries(Object.entries(values).map(([key, value]) => [key, key === "outliers" ? value.map(place) : place(value)]));
  const line = (x1, x2, y1, y2, width = 1) =>
    element("line", { x1: percent(x1), x2: percent(x2), y1, y2, stroke: "#222", "stroke-width": width });
  const label = `median ${values.median.toFixed(3)}, quartiles ${values.q1.toFixed(3)} and ${values.q3.toFixed(3)}, mean ${values.mean.toFixed(3)}`;
  const glyph = element("svg", { role: "img", "aria-label": label });
  for (const tick of [0, 0.25, 0.5, 0.75, 1]) {
    glyph.append(element("line", { x1: percent(tick), x2: percent(tick), y1: -3, y2: 29, stroke: "#e4e1da" }));
  }
  for (const value of b.outliers) glyph.append(element("circle", { cx: percent(value), cy: middle, r: 1.6, fill: "#777" }));
  glyph.append(
    line(b.low, b.q1, middle, middle), line(b.q3, b.high, middle, middle),
    line(b.low, b.low, 8, 18), line(b.high, b.high, 8, 18),
    element("rect", { x: percent(b.q1), width: percent(b.q3 - b.q1), y: 4, height: 18, fill: colour, stroke: "#222" }),
    line(b.median, b.median, 4, 22, 2.5),
    element("circle", { cx: percent(b.mean), cy: middle, r: 3, fill: "#fff", stroke: "#222" }),
  );
  const marked = place(part);
  if (Number.isFinite(marked)) glyph.append(element("line", { x1: percent(marked), x2: percent(marked), y1: 0, y2: 26, stroke: EMPHASIS, "stroke-width": 2.5 }));
  return glyph;
}

function axisGlyph({ low, high }) {
  const glyph = element("svg", { "aria-hidden": "true" });
  for (const tick of [0, 0.5, 1]) {
    const anchor = tick === 0 ? "start" : tick === 1 ? "end" : "middle";
    glyph.append(element("text", { x: percent(tick), y: 12, "text-anchor": anchor }, String(Number((low + tick * (high - low)).toPrecision(3)))));
  }
  return glyph;
}

// One row a run, one column a metric, at the given level of each.
function boxTable(table, place, chosen, part) {
  const head = element("tr", {}, element("th", { scope: "col" }, "run"), ...METRICS.map(({ name }) => element("th", { scope: "col" }, name)));
  const body = element("tbody");
  REPORT.runs.forEach((run, index) => {
    const level = run.levels[Math.min(place, run.levels.length - 1)];
    if (!level) return;
    const colour = REPORT.palette[index % REPORT.palette.length];
    const cells = METRICS.map((metric) => {
      const values = boxesOf(level)[metric.name];
      const marked = index === chosen && part !== null ? level.values[metric.name]?.[part] : undefined;
      const missing = level.undefined?.[metric.name];
      const note = missing ? [element("small", {}, `${missing} undefined`)] : [];
      return element("td", {}, values && Number.isFinite(values.median) ? boxGlyph(values, metric, colour, marked) : "–", ...note);
    });
    body.append(element("tr", index === chosen ? { class: "chosen" } : {}, element("th", { scope: "row" }, run.name), ...cells));
  });
  const foot = element("tr", {}, element("th"), ...METRICS.map((metric) => element("td", {}, axisGlyph(metric))));
  table.replaceChildren(element("thead", {}, head), body, element("tfoot", {}, foot));
}

// A table whose heads sort its rows. A column is {name, value(row), show(value), cell(row)}; cell may give a
// whole element instead. Missing values stay at the end either way.
function sortable(table, columns, rows, finish = () => {}) {
  const order = { column: null, down: false };
  const compare = (column) => (one, other) => {
    const [a, b] = [column.value(one), column.value(other)];
    const missing = (v) => v === null || v === undefined;
    if (missing(a) || missing(b)) return missing(a) - missing(b);
    const sign = typeof a === "string" ? a.localeCompare(b) : a - b;
    return order.down ? -sign : sign;
  };
  const filled = () => {
    const sorted = order.column ? [...rows].sort(compare(order.column)) : rows;
    const body = element("tbody");
    for (const row of sorted) {
      const line = element("tr", {}, ...columns.map((column) => column.cell?.(row) ?? element("td", {}, column.show(column.value(row)))));
      finish(line, row);
      body.append(line);
    }
    table.tBodies[0]?.remove();
    table.append(body);
  };
  const heads = columns.map((column) => {
    const sort = () => {
      order.down = order.column === column ? !order.down : false;
      order.column = column;
      heads.forEach((head, i) => head.setAttribute("aria-sort", columns[i] !== column ? "none" : order.down ? "descending" : "ascending"));
      filled();
    };
    return element("th", { scope: "col", "aria-sort": "none" }, element("button", { type: "button", click: sort }, column.name));
  });
  table.replaceChildren(element("thead", {}, element("tr", {}, ...heads)));
  filled();
}
