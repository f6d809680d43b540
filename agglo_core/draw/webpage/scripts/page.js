// State of the page: two panels, of which the right one may be hidden, and the colours of both.
const WIDE = 900; // CSS pixels of a window that shows two runs beside each other from the start
const CHOICES = choices();
const first = REPORT.runs.findIndex((run) => run.levels.length);
const second = REPORT.runs.findIndex((run, index) => index > first && run.levels.length);
const state = {
  panels: [
    { run: first, level: 0, part: null },
    { run: second < 0 ? first : second, level: 0, part: null },
  ],
  two: second >= 0 && window.innerWidth >= WIDE,
  choice: CHOICES[0],
};

const runOf = ({ run }) => REPORT.runs[run];
const levelOf = (each) => (each.level < 0 ? null : runOf(each).levels[each.level]);
const shownPanels = () => (state.two ? state.panels : state.panels.slice(0, 1));

function clamp(each) {
  each.level = Math.max(-1, Math.min(each.level, runOf(each).levels.length - 1));
  const level = levelOf(each);
  if (!level || !(each.part >= 0 && each.part < level.parts)) each.part = null;
}

// Another run or level in a panel. The right one goes along with the left one while their levels are the same.
function choose(place, change) {
  const [left, right] = state.panels,
    together = place === 0 && left.level === right.level;
  Object.assign(state.panels[place], { part: null }, change);
  if (together) Object.assign(right, { level: left.level, part: null });
  showLevels();
}

// Both panels mark what holds the cell.
function pointAt(place, cell) {
  const parts = shownPanels().map((each) =>
    cell === OUTSIDE ? null : (levelOf(each)?.labels[cell] ?? null),
  );
  mark(parts);
}

function mark(parts) {
  const before = state.panels.map(({ part }) => part);
  state.panels.forEach((each, place) => {
    each.part = parts[place] ?? null;
    clamp(each);
  });
  if (state.panels.some(({ part }, place) => part !== before[place])) showPart();
}

function showLevels() {
  state.panels.forEach(clamp);
  panels.forEach((panel, place) => nameLevel(panel, state.panels[place]));
  $("panels").classList.toggle("two", state.two);
  panels[1].root.hidden = !state.two;
  $("two").checked = state.two;
  $("colour").value = state.choice.key;
  $("pick").disabled = !levelOf(state.panels[0]);
  $("pick").max = (levelOf(state.panels[0])?.parts ?? 1) - 1;
  limits = rangeOf(state.choice, shownPanels().map(levelOf));
  showLegend($("legend"), state.choice, limits);
  showParts(state.panels[0]);
  markRows();
  showPart();
}

function nameLevel(panel, each) {
  const run = runOf(each),
    level = levelOf(each);
  panel.now = level;
  panel.run.value = String(each.run);
  panel.level.max = run.levels.length - 1;
  panel.level.value = each.level;
  const name = level
    ? `${each.level}: ${level.target}, ${shown(level.parts)} agglomerates`
    : `the mesh: ${shown(REPORT.cells)} cells`;
  panel.name.textContent = name;
  panel.level.setAttribute("aria-valuetext", name);
  panel.canvas.setAttribute("aria-label", `${run.name}, level ${name}`);
}

let limits = null; // of the colour scale

function drawAll(settled = true) {
  shownPanels().forEach((each, place) =>
    drawPanel(
      panels[place],
      {
        part: each.part,
        tints: () => tintsOf(state.choice, levelOf(each), limits),
        key: [
          each.run,
          each.level,
          state.choice.key,
          limits.low,
          limits.high,
          isDark(),
          $("side").value,
        ].join(),
        withCells: $("cells").checked,
        drawn: showHint,
      },
      settled,
    ),
  );
}

function showPart() {
  drawAll();
  const [left] = state.panels,
    place = Math.max(left.level, 0);
  $("boxes-hint").textContent =
    `Level ${place}. Boxes span the quartiles, the bar is the median, the dot the mean; ` +
    "whiskers reach at most 1.5 boxes further. The red line is the agglomerate shown above.";
  boxTable(
    $("boxes"),
    place,
    new Map(shownPanels().map((each) => [each.run, each.level === place ? each.part : null])),
  );
  if (document.activeElement !== $("pick")) $("pick").value = left.part ?? "";
  showFacts();
  for (const row of $("parts").tBodies[0]?.rows ?? [])
    row.classList.toggle("chosen", Number(row.dataset.part) === left.part);
  remember();
}

function showHint() {
  const [left] = state.panels,
    level = levelOf(left),
    hidden = level && left.part !== null && !scene.sees(level, left.part);
  $("hint").textContent = hidden
    ? "It cannot be seen from here: choose another view."
    : panels[0].missing ||
      (level ? "Point at the mesh, or type a number." : "Move the slider to a coarse level.");
}

// Called by whoever moves the sight; many a frame are one.
let frame = 0;
function sightChanged() {
  $("zoom").textContent = `${sight.zoom < 10 ? Number(sight.zoom.toFixed(1)) : Math.round(sight.zoom)}×`;
  $("panels").classList.toggle("zoomed", sight.zoom > 1);
  cancelAnimationFrame(frame);
  frame = requestAnimationFrame(() => drawAll(false));
}

const panels = state.panels.map((_, place) => makePanel(place, { chosen: choose, pointed: pointAt }));

function startControls() {
  CHOICES.forEach(({ key, name }) => $("colour").append(element("option", { value: key }, name)));
  $("colour").addEventListener("change", () => {
    state.choice = CHOICES.find(({ key }) => key === $("colour").value);
    showLevels();
  });
  $("two").addEventListener("change", () => {
    state.two = $("two").checked;
    showLevels();
  });
  $("cells").addEventListener("change", showPart);
  $("pick").addEventListener("input", () => mark([$("pick").value === "" ? null : Number($("pick").value)]));
  $("zoom-in").addEventListener("click", () => zoomAt(panels[0], STEP));
  $("zoom-out").addEventListener("click", () => zoomAt(panels[0], 1 / STEP));
  $("zoom-whole").addEventListener("click", wholeScene);
  startDownloads();
  if (!REPORT.stills) return;
  REPORT.stills.forEach(({ name }, place) => $("side").append(element("option", { value: place }, name)));
  $("side").append(element("option", { value: -1 }, "moved apart"));
  $("sides").hidden = false;
  $("side").addEventListener("change", wholeScene);
  $("side").addEventListener("change", showPart);
}

function start() {
  $("panels").append(...panels.map(({ root }) => root));
  startControls();
  showRuns();
  recall();
  showLevels();
  startTheme(() => drawAll());
  new ResizeObserver(() => drawAll()).observe($("panels"));
  window.addEventListener("hashchange", () => {
    recall();
    showLevels();
  });
}

start();
