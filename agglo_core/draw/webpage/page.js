// State of the page (run, level, agglomerate), kept in the address too: #run=metis&level=2&hover=7
const MANY = 600; // agglomerates a table still lists
const state = { run: REPORT.runs.findIndex((run) => run.levels.length), level: 0, part: null };

const runNow = () => REPORT.runs[state.run];
const levelNow = () => (state.level < 0 ? null : runNow().levels[state.level]);

const format = ({ low, high }) => (low >= 0 && high <= 1 ? fixed(3) : shown);
const BASE = [["cells", "cells", shown], ["diameter", "diameter", shown], [REPORT.size, "measure", shown]];
const LAST = ["components", "components", shown];
const measured = METRICS.filter(({ name }) => ![...BASE, LAST].some(([, key]) => key === name));
const FACTS = [...BASE, ...measured.map((metric) => [metric.name, metric.name, format(metric)]), LAST];

function clamped() {
  state.level = Math.max(-1, Math.min(state.level, runNow().levels.length - 1));
  const level = levelNow();
  if (!level || !(state.part >= 0 && state.part < level.parts)) state.part = null;
}

function set(change) {
  const before = { ...state };
  Object.assign(state, change);
  clamped();
  if (state.run !== before.run || state.level !== before.level) showLevel();
  else if (state.part !== before.part) showPart();
}

function showLevel() {
  const run = runNow(), level = levelNow(), range = $("level");
  $("run").value = String(state.run);
  range.min = -1;
  range.max = run.levels.length - 1;
  range.value = state.level;
  const name = level ? `${state.level}: ${level.target}, ${shown(level.parts)} agglomerates` : `the mesh: ${shown(REPORT.cells)} cells`;
  $("level-name").textContent = name;
  range.setAttribute("aria-valuetext", name);
  $("map").setAttribute("aria-label", `${run.name}, level ${name}`);
  $("pick").disabled = !level;
  $("pick").max = level ? level.parts - 1 : 0;
  showParts(level);
  markRows();
  showPart();
}

function showPart() {
  const level = levelNow(), place = Math.max(state.level, 0);
  draw($("map"), level, state.part, $("cells").checked);
  $("boxes-hint").textContent = `Level ${place}. Boxes span the quartiles, the bar is the median, the dot the mean; ` +
    "whiskers reach at most 1.5 boxes further. The red line is the agglomerate shown above.";
  boxTable($("boxes"), place, state.run, level ? state.part : null);
  if (document.activeElement !== $("pick")) $("pick").value = state.part ?? "";
  const facts = level && state.part !== null ? FACTS.filter(([, key]) => level.values[key]) : [];
  $("facts").replaceChildren(...facts.flatMap(([label, key, show]) =>
    [element("dt", {}, label), element("dd", {}, show(level.values[key][state.part]))]));
  const hidden = REPORT.stills && level && state.part !== null && !painted.made.parts.includes(state.part);
  $("hint").textContent = !level ? "Move the slider to a coarse level."
    : hidden ? "It cannot be seen from here: choose another view." : "Point at the mesh, or type a number.";
  for (const row of $("parts").tBodies[0]?.rows ?? []) row.classList.toggle("chosen", Number(row.dataset.part) === state.part);
  remember();
}

function showParts(level) {
  const listed = level && level.parts <= MANY;
  $("parts-hint").textContent = !level ? "The mesh itself is shown: move the slider to a coarse level."
    : listed ? `${runNow().name}, level ${state.level}.`
    : `${shown(level.parts)} agglomerates; the table is left out above ${MANY}.`;
  $("parts-frame").hidden = !listed;
  if (!listed) return $("parts").replaceChildren();
  const pick = (part) => element("td", {}, element("button", { type: "button", click: () => set({ part }) }, String(part)));
  const columns = [{ name: "id", value: (part) => part, cell: pick }, ...FACTS.map(([name, key, show]) =>
    ({ name, value: (part) => level.values[key][part], show }))];
  const follow = (line, part) => {
    line.dataset.part = part;
    line.classList.toggle("chosen", part === state.part);
    line.addEventListener("pointerenter", () => set({ part }));
  };
  return sortable($("parts"), columns, Array.from({ length: level.parts }, (_, part) => part), follow);
}

function markRows() {
  for (const row of $("runs").tBodies[0].rows) {
    row.classList.toggle("chosen", row.dataset.run === `${state.run}` && row.dataset.level === `${state.level}`);
  }
}

function showRuns() {
  const rows = REPORT.runs.flatMap((run, index) =>
    run.levels.length ? run.levels.map((level, place) => ({ run, index, level, place })) : [{ run, index, level: {}, place: null }]);
  const choose = ({ run, index, place }) => element("th", { scope: "row" }, run.levels.length
    ? element("button", { type: "button", click: () => set({ run: index, level: place }) }, run.name) : run.name);
  const number = (name, key, show) => ({ name, value: ({ level }) => level[key], show });
  const columns = [
    { name: "run", value: ({ run }) => run.name, cell: choose },
    { name: "level", value: ({ place }) => place, show: shown },
    { name: "target", value: ({ level }) => level.target, show: (text) => text ?? "–" },
    number("K", "parts", shown),
    ...(METRICS.some(({ name }) => name === "diameter_ratio") ? [] : [number("diam / h*", "diameter_ratio", fixed(3))]),
    ...METRICS.map((metric) => number(metric.name, metric.name, format(metric))),
    ...REPORT.objectives.map((name) => ({ name, value: ({ level }) => level.objectives?.[name], show: shown })),
    number("connected", "connected", (share) => `${shown(100 * share)} %`),
    number("max diam", "max_diameter", shown),
    { name: "seconds", value: ({ run }) => (run.levels.length ? run.seconds : null), show: fixed(2) },
  ];
  sortable($("runs"), columns, rows, (line, { run, index, place }) => {
    line.dataset.run = index;
    line.dataset.level = place;
    line.classList.toggle("chosen", index === state.run && place === state.level);
    if (run.levels.length) return;
    while (line.cells.length > 1) line.deleteCell(1);
    line.append(element("td", { class: "failed", colspan: columns.length - 1 }, run.error));
  });
}

function remember() {
  const words = new URLSearchParams({ run: runNow().name, level: state.level });
  if (state.part !== null) words.set("hover", state.part);
  if (REPORT.stills) words.set("view", $("side").value);
  history.replaceState(null, "", `#${words}`);
}

function recalled() {
  const words = new URLSearchParams(location.hash.slice(1)), change = {};
  const run = REPORT.runs.findIndex(({ name, levels }) => name === words.get("run") && levels.length);
  if (run >= 0) change.run = run;
  if (words.has("level")) change.level = Number.parseInt(words.get("level"), 10) || 0;
  if (words.has("hover")) change.part = Number.parseInt(words.get("hover"), 10);
  if (REPORT.stills && words.has("view")) showSide(words.get("view"));
  return change;
}

function partUnder(event) {
  const level = levelNow(), cell = cellUnder($("map"), event);
  return level && cell !== OUTSIDE ? level.labels[cell] : null;
}

function start() {
  REPORT.runs.forEach((run, index) => {
    if (run.levels.length) $("run").append(element("option", { value: index }, run.name));
  });
  showRuns();
  $("run").addEventListener("change", () => set({ run: Number($("run").value), part: null }));
  $("level").addEventListener("input", () => set({ level: Number($("level").value), part: null }));
  $("cells").addEventListener("change", showPart);
  $("pick").addEventListener("input", () => set({ part: $("pick").value === "" ? null : Number($("pick").value) }));
  $("map").addEventListener("pointermove", (event) => set({ part: partUnder(event) }));
  $("map").addEventListener("pointerdown", (event) => set({ part: partUnder(event) }));
  new ResizeObserver(() => draw($("map"), levelNow(), state.part, $("cells").checked)).observe($("map").parentElement);
  window.addEventListener("hashchange", () => set(recalled()));
  Object.assign(state, recalled());
  clamped();
  showLevel();
}

start();
