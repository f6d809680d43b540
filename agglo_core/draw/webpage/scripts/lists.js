// Tables of agglomerates, runs and levels: what is measured.
const MANY = 600; // agglomerates a table still lists

const format = ({ low, high }) => (low >= 0 && high <= 1 ? fixed(3) : shown);
const BASE = [
  ["cells", "cells", shown],
  ["diameter", "diameter", shown],
  [REPORT.size, "measure", shown],
];
const LAST = ["components", "components", shown];
const measured = METRICS.filter(({ name }) => ![...BASE, LAST].some(([, key]) => key === name));
const FACTS = [...BASE, ...measured.map((metric) => [metric.name, metric.name, format(metric)]), LAST];

// The agglomerates that are marked, a column for each panel.
function showFacts() {
  const marked = shownPanels().map((each) => ({ each, level: levelOf(each) }));
  const value = ({ each, level }, key) =>
    level && each.part !== null ? level.values[key]?.[each.part] : undefined;
  const rows = FACTS.filter(([, key]) => marked.some((one) => value(one, key) !== undefined));
  const line = ([label, key, show]) =>
    element(
      "tr",
      {},
      element("th", { scope: "row" }, label),
      ...marked.map((one) => element("td", {}, show(value(one, key)))),
    );
  const names = element(
    "tr",
    {},
    element("th", { scope: "col" }, "number"),
    ...marked.map(({ each }) => element("td", {}, shown(each.part))),
  );
  $("facts").replaceChildren(
    ...(rows.length ? [element("tbody", {}, ...(state.two ? [names] : []), ...rows.map(line))] : []),
  );
}

const partColumns = (level) =>
  FACTS.filter(([, key]) => level.values[key]).map(([name, key, show]) => ({
    name,
    value: (part) => level.values[key][part],
    show,
  }));
const partRows = (level) => Array.from({ length: level.parts }, (_, part) => part);

function showParts(each) {
  const level = levelOf(each),
    listed = level && level.parts <= MANY;
  $("parts-hint").textContent = !level
    ? "The mesh itself is shown: move the slider to a coarse level."
    : listed
      ? `${runOf(each).name}, level ${each.level}.`
      : `${runOf(each).name}, level ${each.level}: ${shown(level.parts)} agglomerates, more than the ${MANY} that are listed here.`;
  $("parts-csv").hidden = !level;
  $("parts-frame").hidden = !listed;
  if (!listed) return $("parts").replaceChildren();
  const pick = (part) =>
    element("td", {}, element("button", { type: "button", click: () => mark([part]) }, String(part)));
  const follows = (line, part) => {
    line.dataset.part = part;
    line.classList.toggle("chosen", part === each.part);
    line.addEventListener("pointerenter", () => mark([part]));
  };
  return sortable(
    $("parts"),
    [{ name: "id", value: (part) => part, cell: pick }, ...partColumns(level)],
    partRows(level),
    follows,
  );
}

function markRows() {
  const chosen = shownPanels().map(({ run, level }) => `${run} ${level}`);
  for (const row of $("runs").tBodies[0].rows)
    row.classList.toggle("chosen", chosen.includes(`${row.dataset.run} ${row.dataset.level}`));
}

const runRows = () =>
  REPORT.runs.flatMap((run, index) =>
    run.levels.length
      ? run.levels.map((level, place) => ({ run, index, level, place }))
      : [{ run, index, level: {}, place: null }],
  );

function runColumns() {
  const pick = ({ run, index, place }) =>
    element(
      "th",
      { scope: "row" },
      run.levels.length
        ? element(
            "button",
            { type: "button", click: () => choose(0, { run: index, level: place }) },
            run.name,
          )
        : run.name,
    );
  const number = (name, key, show) => ({ name, value: ({ level }) => level[key], show });
  return [
    { name: "run", value: ({ run }) => run.name, cell: pick },
    { name: "level", value: ({ place }) => place, show: shown },
    { name: "target", value: ({ level }) => level.target, show: (text) => text ?? "–" },
    number("K", "parts", shown),
    ...(METRICS.some(({ name }) => name === "diameter_ratio")
      ? []
      : [number("diam / h*", "diameter_ratio", fixed(3))]),
    ...METRICS.map((metric) => number(metric.name, metric.name, format(metric))),
    ...REPORT.objectives.map((name) => ({
      name,
      value: ({ level }) => level.objectives?.[name],
      show: shown,
    })),
    number("connected", "connected", (share) => `${shown(100 * share)} %`),
    number("max diam", "max_diameter", shown),
    { name: "CPU s", value: ({ run }) => (run.levels.length ? run.cpu_seconds : null), show: fixed(2) },
  ];
}

const ERROR = { name: "error", value: ({ run }) => run.error };

function showRuns() {
  const columns = runColumns();
  sortable(
    $("runs"),
    columns,
    runRows(),
    (line, { run, index, place }) => {
      Object.assign(line.dataset, { run: index, level: place });
      if (!run.levels.length) {
        while (line.cells.length > 1) line.deleteCell(1);
        line.append(element("td", { class: "failed", colspan: columns.length - 1 }, run.error));
      }
    },
    markRows,
  );
}

function startDownloads() {
  $("runs-csv").addEventListener("click", () =>
    download(fileName(REPORT.name, "runs"), tableCsv([...runColumns(), ERROR], runRows())),
  );
  $("parts-csv").addEventListener("click", () => {
    const [left] = state.panels,
      columns = [{ name: "id", value: (part) => part }, ...partColumns(levelOf(left))];
    download(
      fileName(REPORT.name, runOf(left).name, "level", left.level),
      tableCsv(columns, partRows(levelOf(left))),
    );
  });
  panels.forEach((panel, place) =>
    panel.root.querySelector(".labels").addEventListener("click", () => {
      const run = runOf(state.panels[place]);
      download(fileName(REPORT.name, run.name, "labels"), labelsCsv(run));
    }),
  );
}
