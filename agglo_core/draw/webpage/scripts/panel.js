// A panel: one level of one run on a canvas. Several panels see the same part of the scene.
const SLOW = 60,
  REST = 150; // ms of a picture that is only moved while the sight moves; of rest until it is made anew

function makePanel(place, heard) {
  const root = $("panel").content.firstElementChild.cloneNode(true);
  const find = (name) => root.querySelector(`.${name}`);
  const panel = {
    root,
    canvas: find("map"),
    run: find("run"),
    level: find("level"),
    name: find("level-name"),
    now: null,
    base: document.createElement("canvas"),
    made: null,
    cost: 0,
    rest: 0,
    missing: "",
  };
  REPORT.runs.forEach((run, index) => {
    if (run.levels.length) panel.run.append(element("option", { value: index }, run.name));
  });
  panel.run.addEventListener("change", () => heard.chosen(place, { run: Number(panel.run.value) }));
  panel.level.addEventListener("input", () => heard.chosen(place, { level: Number(panel.level.value) }));
  const pointed = (px, py) => heard.pointed(place, scene.cellAt(under(viewOf(panel), px, py), panel.now));
  follow(panel, pointed);
  return panel;
}

// Height of the canvas by its width: the whole scene fits, and the canvas into the window.
function fitCanvas({ canvas, now }) {
  const { width, height } = scene.box(now),
    room = canvas.clientWidth - 2 * MARGIN;
  const most = 0.8 * Math.max(window.innerHeight, 400);
  canvas.style.height = `${Math.round(Math.min(Math.max((room * height) / width + 2 * MARGIN, 120), most))}px`;
  const dots = window.devicePixelRatio || 1;
  return { width: Math.round(canvas.clientWidth * dots), height: Math.round(canvas.clientHeight * dots) };
}

function sized(canvas, size) {
  if (canvas.width !== size.width || canvas.height !== size.height) Object.assign(canvas, size);
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.resetTransform();
  context.clearRect(0, 0, canvas.width, canvas.height);
  return context;
}

// ``content`` is {part, tints, key, withCells, drawn}: the agglomerate that is marked, a function that gives the
// colours of cells, what tells whether these, or the level, are others than before, and who is told at the end.
function drawPanel(panel, content, settled = true) {
  const size = fitCanvas(panel),
    view = viewOf(panel),
    level = panel.now;
  const key = [size.width, size.height, view.scale, view.x, view.y, content.key, content.withCells].join();
  if (panel.made?.key !== key && !settled && panel.cost > SLOW && panel.made) {
    panel.canvas.setAttribute("aria-busy", "true");
    moved(panel, size, view);
    clearTimeout(panel.rest);
    panel.rest = setTimeout(() => drawPanel(panel, content), REST);
    return;
  }
  clearTimeout(panel.rest);
  if (panel.made?.key !== key) {
    const start = performance.now();
    panel.missing = scene.paint(sized(panel.base, size), view, level, content.tints(), content.withCells);
    Object.assign(panel, { made: { key, view }, cost: performance.now() - start });
  }
  const context = sized(panel.canvas, size);
  context.drawImage(panel.base, 0, 0);
  if (level && content.part !== null) scene.mark(context, view, level, content.part);
  panel.canvas.setAttribute("aria-busy", "false");
  content.drawn();
}

// The last picture where the sight is now.
function moved(panel, size, view) {
  const before = panel.made.view,
    grown = view.scale / before.scale,
    { width, height } = panel.base;
  const left = width / 2 + (before.x - view.x) * view.scale * view.dots - (grown * width) / 2;
  const downwards = (scene.upwards ? -1 : 1) * (before.y - view.y) * view.scale * view.dots;
  sized(panel.canvas, size).drawImage(
    panel.base,
    left,
    height / 2 + downwards - (grown * height) / 2,
    grown * width,
    grown * height,
  );
}
