// The mesh on a canvas: agglomerates filled by colour, their outlines, and which one lies under a point.
const INK = "#222", FINE = "#555", PAPER = "#f4f1ea", EMPHASIS = "#b00020";

function box(points) {
  const low = [Infinity, Infinity], high = [-Infinity, -Infinity];
  for (let i = 0; i < points.length; i++) {
    low[i % 2] = Math.min(low[i % 2], points[i]);
    high[i % 2] = Math.max(high[i % 2], points[i]);
  }
  return { low, high, width: high[0] - low[0], height: high[1] - low[1] };
}

const BOX = box(REPORT.points);
const x = (vertex) => REPORT.points[2 * vertex];
const y = (vertex) => REPORT.points[2 * vertex + 1];

// Closed loops from directed edges (start -> ends): as many edges enter a vertex as leave it, so whichever is
// taken next, the walk comes home, and the winding number of the whole is 1 inside and 0 in holes.
function traced(edges) {
  const path = new Path2D();
  for (const [start, ends] of edges) {
    while (ends.length) {
      path.moveTo(x(start), y(start));
      for (let at = ends.pop(); at !== start; at = edges.get(at).pop()) path.lineTo(x(at), y(at));
      path.closePath();
    }
  }
  return path;
}

function addEdge(edges, from, to) {
  if (edges.has(from)) edges.get(from).push(to);
  else edges.set(from, [to]);
}

// Filled areas by colour, and the lines between different parts, of cells given their part.
function paths(partOf, colourOf, nColours) {
  const areas = Array.from({ length: nColours }, () => new Map());
  const lines = new Path2D();
  for (let face = 0; face < REPORT.faces.length / 2; face++) {
    const [a, b] = [REPORT.faces[2 * face], REPORT.faces[2 * face + 1]];
    const [left, right] = [partOf(REPORT.sides[2 * face]), partOf(REPORT.sides[2 * face + 1])];
    if (left === right) continue;
    if (left >= 0) addEdge(areas[colourOf(left)], a, b);
    if (right >= 0) addEdge(areas[colourOf(right)], b, a);
    lines.moveTo(x(a), y(a));
    lines.lineTo(x(b), y(b));
  }
  return { areas: areas.map(traced), lines };
}

function levelPaths(level) {
  level.paths ??= paths((cell) => (cell === OUTSIDE ? -1 : level.labels[cell]), (part) => level.colours[part], REPORT.palette.length);
  return level.paths;
}

const domain = paths((cell) => (cell === OUTSIDE ? -1 : 0), () => 0, 1);
const mesh = new Path2D();
for (let face = 0; face < REPORT.faces.length / 2; face++) {
  mesh.moveTo(x(REPORT.faces[2 * face]), y(REPORT.faces[2 * face]));
  mesh.lineTo(x(REPORT.faces[2 * face + 1]), y(REPORT.faces[2 * face + 1]));
}

function partPath(level, part) {
  return paths((cell) => (cell !== OUTSIDE && level.labels[cell] === part ? 0 : -1), () => 0, 1).areas[0];
}

// Size of the canvas in CSS pixels at equal scale of both axes, and pixels per unit.
function fitted(canvas) {
  const margin = 8, ratio = BOX.height / BOX.width || 1;
  const width = canvas.clientWidth;
  const height = Math.round(Math.min(Math.max((width - 2 * margin) * ratio + 2 * margin, 60), 0.8 * Math.max(window.innerHeight, 500)));
  canvas.style.height = `${height}px`;
  const scale = Math.min((width - 2 * margin) / BOX.width, (height - 2 * margin) / BOX.height);
  return { width, height, scale };
}

// A context in mesh coordinates (the box in the middle, y upwards) and a pen of so many CSS pixels.
function brush(canvas, scale, dots) {
  const context = canvas.getContext("2d"), s = scale * dots;
  const [cx, cy] = [BOX.low[0] + BOX.width / 2, BOX.low[1] + BOX.height / 2];
  context.setTransform(s, 0, 0, -s, canvas.width / 2 - s * cx, canvas.height / 2 + s * cy);
  context.lineJoin = context.lineCap = "round";
  const stroke = (path, colour, pixels) => {
    context.strokeStyle = colour;
    context.lineWidth = pixels / scale;
    context.stroke(path);
  };
  return { context, stroke };
}

// The mesh or a level: areas, then the cells' edges where there is room for them, then outlines.
function paint(canvas, level, withCells, scale, dots) {
  const { context, stroke } = brush(canvas, scale, dots);
  const shapes = level ? levelPaths(level) : domain;
  shapes.areas.forEach((area, colour) => {
    context.fillStyle = level ? REPORT.palette[colour] : PAPER;
    context.fill(area);
  });
  const roomFor = (count) => scale * Math.sqrt((BOX.width * BOX.height) / count);
  if (withCells && roomFor(REPORT.cells) > 1.5) {
    context.globalAlpha = level ? 0.35 : 0.9;
    stroke(mesh, FINE, Math.min(0.8, 0.06 * roomFor(REPORT.cells) + 0.1));
    context.globalAlpha = 1;
  }
  stroke(shapes.lines, INK, Math.min(1.4, 0.06 * roomFor(level ? level.parts : 1) + 0.2));
}

const painted = { key: "", picture: document.createElement("canvas"), level: undefined };

// Pointing redraws often, so the picture below the emphasis is kept until something else changes.
function draw(canvas, level, part, withCells) {
  const { width, height, scale } = fitted(canvas), dots = window.devicePixelRatio || 1;
  const key = [width, height, dots, withCells].join();
  for (const each of [canvas, painted.picture]) {
    if (each.width !== Math.round(width * dots)) each.width = Math.round(width * dots);
    if (each.height !== Math.round(height * dots)) each.height = Math.round(height * dots);
  }
  if (painted.key !== key || painted.level !== level) {
    Object.assign(painted, { key, level });
    clear(painted.picture);
    paint(painted.picture, level, withCells, scale, dots);
  }
  clear(canvas).drawImage(painted.picture, 0, 0);
  if (level && part !== null) {
    const { stroke } = brush(canvas, scale, dots), area = partPath(level, part);
    stroke(area, "#fff", 6);
    stroke(area, EMPHASIS, 3);
  }
}

function clear(canvas) {
  const context = canvas.getContext("2d");
  context.resetTransform();
  context.clearRect(0, 0, canvas.width, canvas.height);
  return context;
}

// Cell under a point: the nearest edge to its right tells, by the side the point lies on.
function cellAt(px, py) {
  let nearest = Infinity, cell = OUTSIDE;
  for (let face = 0; face < REPORT.faces.length / 2; face++) {
    const [a, b] = [REPORT.faces[2 * face], REPORT.faces[2 * face + 1]];
    if (y(a) > py === y(b) > py) continue;
    const crossing = x(a) + ((py - y(a)) / (y(b) - y(a))) * (x(b) - x(a));
    if (crossing < px || crossing >= nearest) continue;
    nearest = crossing;
    cell = REPORT.sides[2 * face + (y(b) > y(a) ? 0 : 1)]; // left of an edge that goes up is the owner
  }
  return cell;
}

function cellUnder(canvas, event) {
  const { scale } = fitted(canvas), frame = canvas.getBoundingClientRect();
  const px = (event.clientX - frame.left - frame.width / 2) / scale + BOX.low[0] + BOX.width / 2;
  const py = -(event.clientY - frame.top - frame.height / 2) / scale + BOX.low[1] + BOX.height / 2;
  return cellAt(px, py);
}
