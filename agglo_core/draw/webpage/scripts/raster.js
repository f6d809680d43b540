// Which cell of a plane mesh is at every dot of a picture, by its faces alone: cells are never put together.
const PLANE = facesOf(REPORT.plane);

function facesOf({ low, gap, ends, x, y, step }) {
  let newest = 0;
  const points = Uint32Array.from(ends, (back) => {
    const point = newest - back;
    newest += back === 0;
    return point;
  });
  const right = low.map((cell, face) => (gap[face] ? cell + gap[face] : OUTSIDE));
  return {
    count: low.length,
    points,
    left: low,
    right,
    x: Float64Array.from(x),
    y: Float64Array.from(y),
    step,
  };
}

// From the scene to dots of a picture: x0 + s x to the right, y0 - s y downwards.
function dotsOf(view, columns, rows, density) {
  const s = view.scale * density;
  return { s, x0: columns / 2 - s * view.x, y0: rows / 2 + s * view.y };
}

const canvasOfDots = { reach: new Float64Array(0), cells: new Int32Array(0), key: "" };

// Cells row by row. On each row the faces that cross its middle tell which cell begins to the right of the
// crossing. Two panels that see the same share the result.
function cellsSeen(view, columns, rows, density) {
  const { s, x0, y0 } = dotsOf(view, columns, rows, density),
    key = [s, x0, y0, columns, rows].join();
  if (canvasOfDots.key === key) return canvasOfDots.cells;
  if (canvasOfDots.cells.length !== columns * rows) {
    Object.assign(canvasOfDots, {
      reach: new Float64Array(columns * rows),
      cells: new Int32Array(columns * rows),
    });
  }
  const { reach, cells } = canvasOfDots,
    { count, points, left, right, x, y } = PLANE;
  canvasOfDots.key = key;
  reach.fill(-Infinity);
  cells.fill(-1);
  for (let face = 0; face < count; face++) {
    const a = points[2 * face],
      b = points[2 * face + 1];
    const ay = y0 - s * y[a],
      by = y0 - s * y[b];
    const first = Math.max(0, Math.ceil(Math.min(ay, by) - 0.5)),
      end = Math.min(rows, Math.ceil(Math.max(ay, by) - 0.5));
    if (first >= end) continue;
    const ax = x0 + s * x[a],
      slope = (x0 + s * x[b] - ax) / (by - ay),
      cell = ay > by ? right[face] : left[face];
    for (let row = first; row < end; row++) {
      const crossing = ax + (row + 0.5 - ay) * slope,
        column = Math.max(0, Math.ceil(crossing - 0.5));
      if (column >= columns) continue;
      const at = row * columns + column;
      if (crossing > reach[at]) {
        reach[at] = crossing;
        cells[at] = cell;
      }
    }
  }
  for (let row = 0, at = 0; row < rows; row++) {
    for (let column = 0, cell = OUTSIDE; column < columns; column++, at++) {
      if (cells[at] < 0) cells[at] = cell;
      else cell = cells[at];
    }
  }
  return cells;
}

// The cell at one point of the scene: that on the left of the nearest face to the right, seen from below.
function cellAt({ x: px, y: py }) {
  const { count, points, left, right, x, y } = PLANE;
  let nearest = Infinity,
    cell = OUTSIDE;
  for (let face = 0; face < count; face++) {
    const a = points[2 * face],
      b = points[2 * face + 1];
    if (y[a] > py === y[b] > py) continue;
    const crossing = x[a] + ((py - y[a]) / (y[b] - y[a])) * (x[b] - x[a]);
    if (crossing < px || crossing >= nearest) continue;
    nearest = crossing;
    cell = y[b] > y[a] ? left[face] : right[face];
  }
  return cell;
}
