// What part of the scene is seen: one zoom and centre for all panels; how pointer, wheel and keys move it.
const MARGIN = 8,
  STEP = 1.5,
  SHIFT = 0.15; // CSS pixels around the whole; zoom of a key; share of the width an arrow moves
const sight = { zoom: 1, x: 0.5, y: 0.5 }; // the centre in shares of the scene

// The scene on the canvas of a panel: CSS pixels per unit, and which point of the scene is in the middle.
function viewOf({ canvas, now }) {
  const { width: wide, height: high, x, y } = scene.box(now),
    { clientWidth: width, clientHeight: height } = canvas;
  const fit = Math.min((width - 2 * MARGIN) / wide, (height - 2 * MARGIN) / high);
  const dots = window.devicePixelRatio || 1;
  return { width, height, dots, scale: fit * sight.zoom, x: x + sight.x * wide, y: y + sight.y * high };
}

// The point of the scene under a point of the canvas; the y of a mesh grows upwards.
const under = (view, px, py) => ({
  x: view.x + (px - view.width / 2) / view.scale,
  y: view.y + ((scene.upwards ? -1 : 1) * (py - view.height / 2)) / view.scale,
});

function lookAt(zoom, x, y) {
  const kept = (share) => Math.min(Math.max(share, 0), 1);
  sight.zoom = Math.min(Math.max(zoom, 1), scene.mostZoom());
  Object.assign(sight, sight.zoom === 1 ? { x: 0.5, y: 0.5 } : { x: kept(x), y: kept(y) });
  sightChanged();
}

// Zoom so that what is under a point of the canvas stays there.
function zoomAt(panel, factor, px = panel.canvas.clientWidth / 2, py = panel.canvas.clientHeight / 2) {
  const box = scene.box(panel.now),
    view = viewOf(panel),
    before = under(view, px, py);
  const zoom = Math.min(Math.max(sight.zoom * factor, 1), scene.mostZoom());
  const after = under({ ...view, scale: (view.scale * zoom) / sight.zoom }, px, py);
  lookAt(zoom, sight.x + (before.x - after.x) / box.width, sight.y + (before.y - after.y) / box.height);
}

function shift(panel, dx, dy) {
  const box = scene.box(panel.now),
    { scale } = viewOf(panel);
  lookAt(
    sight.zoom,
    sight.x + dx / scale / box.width,
    sight.y + ((scene.upwards ? -1 : 1) * dy) / scale / box.height,
  );
}

const wholeScene = () => lookAt(1, 0.5, 0.5);

function pressed(panel, key) {
  const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[key];
  if (way) shift(panel, ...way.map((each) => each * SHIFT * panel.canvas.clientWidth));
  else if (key === "+" || key === "=") zoomAt(panel, STEP);
  else if (key === "-" || key === "−") zoomAt(panel, 1 / STEP);
  else if (key === "0") wholeScene();
  else return false;
  return true;
}

// Where a pointer is on a canvas, in CSS pixels from its corner inside the border.
function placeOn(canvas, event) {
  const frame = canvas.getBoundingClientRect();
  return [event.clientX - frame.left - canvas.clientLeft, event.clientY - frame.top - canvas.clientTop];
}

// Drag, pinch, wheel, double click and keys; ``pointed`` hears of pointers that only point.
function follow(panel, pointed) {
  const { canvas } = panel;
  followPointers(panel, pointed);
  const turned = (event) => {
    if (!event.ctrlKey && !event.metaKey && document.activeElement !== canvas) return; // the page scrolls
    event.preventDefault();
    const way = -event.deltaY * (event.deltaMode ? 0.05 : 0.002) * (event.ctrlKey ? 3 : 1);
    zoomAt(panel, Math.exp(way), ...placeOn(canvas, event));
  };
  canvas.addEventListener("wheel", turned, { passive: false });
  canvas.addEventListener("dblclick", wholeScene);
  canvas.addEventListener("keydown", (event) => {
    const plainKey = !event.ctrlKey && !event.metaKey && !event.altKey;
    if (plainKey && pressed(panel, event.key)) event.preventDefault();
  });
}

function followPointers(panel, pointed) {
  const { canvas } = panel;
  const down = new Map(); // pointers that are down and where they are
  const spread = () => {
    const [a, b] = [...down.values()];
    return { gap: Math.hypot(a[0] - b[0], a[1] - b[1]) || 1, middle: [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2] };
  };
  canvas.addEventListener("pointerdown", (event) => {
    down.set(event.pointerId, placeOn(canvas, event));
    if (event.isTrusted) canvas.setPointerCapture(event.pointerId);
    pointed(...placeOn(canvas, event));
  });
  canvas.addEventListener("pointermove", (event) => {
    const place = placeOn(canvas, event);
    const before = down.get(event.pointerId);
    if (!before) return pointed(...place);
    const apart = down.size === 2 && spread();
    down.set(event.pointerId, place);
    if (apart) {
      const now = spread();
      zoomAt(panel, now.gap / apart.gap, ...now.middle);
      shift(panel, apart.middle[0] - now.middle[0], apart.middle[1] - now.middle[1]);
    } else if (down.size === 1) shift(panel, before[0] - place[0], before[1] - place[1]);
    return undefined;
  });
  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, (event) => down.delete(event.pointerId));
  }
}
