// A plane mesh as a scene: cells filled by their colours, with the lines there is room for.
const ROOM = 2.5; // CSS pixels of a mean edge of a cell below which the cells' edges would only be grey
const PART_ROOM = 3; // CSS pixels of a mean agglomerate, the same for outlines
const MOST_DOTS = 5e6; // of a picture that is made finer than the screen, to smooth its edges
const DEEPEST = 8; // CSS pixels of one step of the grid of points

const scene = {
  upwards: true,
  extent: {
    x: 0,
    y: 0,
    width: PLANE.x.reduce((a, b) => Math.max(a, b), 1),
    height: PLANE.y.reduce((a, b) => Math.max(a, b), 1),
  },
  box() {
    return this.extent;
  },
  mostZoom() {
    return Math.max(8, (DEEPEST * Math.max(this.extent.width, this.extent.height)) / 500);
  },
  cellAt,
  sees: () => true,

  // Fill ``context`` with tints of cells, edges and outlines; returns what could not be drawn.
  paint(context, view, level, tints, withCells) {
    const { width, height } = context.canvas;
    const finer = 4 * width * height <= MOST_DOTS ? 2 : 1;
    const picture = filled(view, finer * width, finer * height, finer * view.dots, tints);
    context.imageSmoothingQuality = "high";
    context.drawImage(picture, 0, 0, width, height);
    const coloured = level || tints[0] !== tints[REPORT.cells - 1];
    const crowded = withCells && !paintEdges(context, view, coloured);
    if (!paintOutlines(context, view, level))
      return "Agglomerates are too small for outlines here: zoom in to see them.";
    return crowded ? "Cells are too small for lines here: zoom in to see them." : "";
  },

  // A line around one agglomerate.
  mark(context, view, { labels }, part) {
    const { path } = lines(
      view,
      context.canvas,
      (left, right) => (labels[left] === part) !== (right !== OUTSIDE && labels[right] === part),
    );
    stroke(context, path, "#fff", 6 * view.dots);
    stroke(context, path, toneOf("--mark"), 3 * view.dots);
  },
};

// The edges of cells, if there is room; whether there is.
function paintEdges(context, view, coloured) {
  const edges = lines(view, context.canvas, () => true);
  const pixels = edges.mean / view.dots;
  if (edges.count && pixels < ROOM) return false;
  context.globalAlpha = coloured ? Math.min(0.15 + pixels / 60, 0.45) : 0.9;
  const tone = toneOf(coloured ? "--ink-on-colours" : "--fine");
  stroke(context, edges.path, tone, view.dots * Math.min(0.8, 0.25 + pixels / 20));
  context.globalAlpha = 1;
  return true;
}

// The outline of the mesh and, if there is room, of its agglomerates; whether there is.
function paintOutlines(context, view, level) {
  const room = level ? roomOf(view, level.parts) : Infinity;
  const labels = room >= PART_ROOM ? level?.labels : undefined;
  const differ = (left, right) => right === OUTSIDE || (labels && labels[left] !== labels[right]);
  const tone = toneOf(level ? "--ink-on-colours" : "--ink");
  stroke(
    context,
    lines(view, context.canvas, differ).path,
    tone,
    view.dots * Math.min(1.4, 0.2 + 0.06 * room),
  );
  return room >= PART_ROOM;
}

// Mean width of one of so many parts in CSS pixels.
const roomOf = (view, count) => view.scale * Math.sqrt((scene.extent.width * scene.extent.height) / count);

const scratch = document.createElement("canvas");

function filled(view, columns, rows, density, tints) {
  const cells = cellsSeen(view, columns, rows, density),
    image = new ImageData(columns, rows);
  const dots = new Uint32Array(image.data.buffer);
  for (let at = 0; at < dots.length; at++) dots[at] = tints[cells[at]];
  if (scratch.width !== columns || scratch.height !== rows)
    Object.assign(scratch, { width: columns, height: rows });
  scratch.getContext("2d", { willReadFrequently: true }).putImageData(image, 0, 0);
  return scratch;
}

// The faces in sight whose two cells ``wanted`` wants, as a path in dots; how many, and how long in the mean.
function lines(view, { width, height }, wanted) {
  const { s, x0, y0 } = dotsOf(view, width, height, view.dots),
    { points, left, right, x, y } = PLANE;
  const path = new Path2D();
  let count = 0,
    sum = 0;
  for (let face = 0; face < PLANE.count; face++) {
    if (!wanted(left[face], right[face])) continue;
    const a = points[2 * face],
      b = points[2 * face + 1];
    const ax = x0 + s * x[a],
      ay = y0 - s * y[a],
      bx = x0 + s * x[b],
      by = y0 - s * y[b];
    if (Math.max(ax, bx) < 0 || Math.min(ax, bx) > width || Math.max(ay, by) < 0 || Math.min(ay, by) > height)
      continue;
    path.moveTo(ax, ay);
    path.lineTo(bx, by);
    count++;
    sum += Math.hypot(bx - ax, by - ay);
  }
  return { path, count, mean: count ? sum / count : 0 };
}

function stroke(context, path, tone, width) {
  Object.assign(context, { strokeStyle: tone, lineWidth: width, lineJoin: "round", lineCap: "round" });
  context.stroke(path);
}
