// A solid from several sides: each still knows the face that is seen at every pixel, and the cell of each face.
const INK = [0x22, 0x22, 0x22], PAPER = [0xf4, 0xf1, 0xea], EMPHASIS = "#b00020";
const MARK = [0xb0, 0x00, 0x20], ROOM = 5; // pixels across a face that leave something between lines
const APART = -1; // the place of the still that each level has of its own
const TONES = REPORT.palette.map((tone) => [1, 3, 5].map((k) => Number.parseInt(tone.slice(k, k + 2), 16)));

// Pixel by pixel: face + 1, or 0 where there is nothing.
function decodedStill(still) {
  if (still.pixels) return still;
  const faces = unpacked(still.faces), lengths = unpacked(still.lengths);
  const pixels = new Uint32Array(still.width * still.height);
  for (let run = 0, at = 0; run < faces.length; at += lengths[run++]) pixels.fill(faces[run], at, at + lengths[run]);
  const covered = pixels.reduce((count, face) => count + (face > 0), 0);
  return Object.assign(still, { pixels, cells: unpacked(still.cells), bright: unpacked(still.bright), covered });
}

function stillNow(level) {
  const side = Number($("side").value);
  return decodedStill(side !== APART ? REPORT.stills[side] : level ? level.apart : REPORT.stills[0]);
}

// The part at each pixel, −1 where there is nothing; the mesh itself is one part.
function partsSeen(still, level) {
  const parts = new Int32Array(still.pixels.length);
  for (let at = 0; at < parts.length; at++) {
    const face = still.pixels[at];
    parts[at] = !face ? -1 : level ? level.labels[still.cells[face - 1]] : 0;
  }
  return parts;
}

// Call ``found`` at every pixel whose value differs from that of the next one to the right or below.
function changes(values, width, found) {
  for (let at = 0; at + width < values.length; at++) {
    if (values[at] !== values[at + 1] || values[at] !== values[at + width]) found(at);
  }
}

function paint(still, level, withCells) {
  const { pixels, width, height } = still, image = new ImageData(width, height), bytes = image.data;
  const parts = partsSeen(still, level);
  for (let at = 0; at < pixels.length; at++) {
    if (!pixels[at]) continue;
    const tone = level ? TONES[level.colours[parts[at]]] : PAPER, light = still.bright[pixels[at] - 1] / 255;
    for (let k = 0; k < 3; k++) bytes[4 * at + k] = tone[k] * light;
    bytes[4 * at + 3] = 255;
  }
  if (withCells && still.covered > ROOM * ROOM * still.cells.length) {
    changes(pixels, width, (at) => { for (let k = 0; k < 3; k++) bytes[4 * at + k] *= 0.8; });
  }
  changes(parts, width, (at) => inked(bytes, at, INK));
  return { image, parts };
}

function inked(bytes, at, ink) {
  for (let k = 0; k < 3; k++) bytes[4 * at + k] = ink[k];
  bytes[4 * at + 3] = 255;
}

// A red line, three pixels wide, around what is seen of a part.
function marked({ image, parts }, part) {
  const found = new ImageData(new Uint8ClampedArray(image.data), image.width), width = image.width;
  const own = parts.map((each) => Number(each === part));
  changes(own, width, (at) => {
    for (const step of [0, 1, -1, width, -width]) if (at + step >= 0 && at + step < own.length) inked(found.data, at + step, MARK);
  });
  return found;
}

const painted = { still: null, level: undefined, withCells: null, made: null, canvas: document.createElement("canvas") };

// Pointing redraws often, so what is painted is kept until something else than the part changes.
function draw(canvas, level, part, withCells) {
  const still = stillNow(level), { width, height } = fitted(canvas, still), dots = window.devicePixelRatio || 1;
  if (painted.still !== still || painted.level !== level || painted.withCells !== withCells) {
    Object.assign(painted, { still, level, withCells, made: paint(still, level, withCells) });
    Object.assign(painted.canvas, { width: still.width, height: still.height });
  }
  const shownNow = level && part !== null ? marked(painted.made, part) : painted.made.image;
  painted.canvas.getContext("2d").putImageData(shownNow, 0, 0);
  Object.assign(canvas, { width: Math.round(canvas.clientWidth * dots), height: Math.round(height * dots) });
  const context = canvas.getContext("2d");
  context.imageSmoothingQuality = "high";
  context.drawImage(painted.canvas, (dots * (canvas.clientWidth - width)) / 2, 0, dots * width, dots * height);
}

// Size of the still on the canvas in CSS pixels, at most its own.
function fitted(canvas, still) {
  const most = 0.8 * Math.max(window.innerHeight, 500);
  const scale = Math.min(canvas.clientWidth / still.width, most / still.height, 1);
  const size = { width: scale * still.width, height: scale * still.height, scale };
  canvas.style.height = `${size.height}px`;
  return size;
}

function cellUnder(canvas, event) {
  const still = painted.still, { width, scale } = fitted(canvas, still), frame = canvas.getBoundingClientRect();
  const border = canvas.clientLeft;
  const x = Math.floor((event.clientX - frame.left - border - (canvas.clientWidth - width) / 2) / scale);
  const y = Math.floor((event.clientY - frame.top - border) / scale);
  const face = x >= 0 && x < still.width && y >= 0 && y < still.height ? still.pixels[y * still.width + x] : 0;
  return face ? still.cells[face - 1] : OUTSIDE;
}

// Choose a still by its place, if there is one of that place.
function showSide(place) {
  const before = $("side").value;
  $("side").value = place;
  if ($("side").selectedIndex < 0) $("side").value = before;
  if (painted.still && $("side").value !== before) showPart();
}

REPORT.stills.forEach(({ name }, place) => $("side").append(element("option", { value: place }, name)));
$("side").append(element("option", { value: APART }, "moved apart"));
$("side").addEventListener("change", () => showPart());
