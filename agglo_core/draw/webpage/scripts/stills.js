// A solid as a scene: stills that know the face seen at every pixel, and the cell of each face.
const CUTS = 5; // pixels across a face that leave something between lines
const APART = -1; // the place of the still that each level has of its own
const INK = [0x22, 0x22, 0x22];

// Pixel by pixel: face + 1, or 0 where there is nothing.
function decodedStill(still) {
  if (still.pixels) return still;
  const { faces, lengths } = still,
    pixels = new Uint32Array(still.width * still.height);
  for (let run = 0, at = 0; run < faces.length; at += lengths[run++])
    pixels.fill(faces[run], at, at + lengths[run]);
  const covered = pixels.reduce((count, face) => count + (face > 0), 0);
  return Object.assign(still, { pixels, covered });
}

const sideNow = () => Number($("side").value);
const stillOf = (level) =>
  decodedStill(sideNow() !== APART ? REPORT.stills[sideNow()] : level ? level.apart : REPORT.stills[0]);

// The part at each pixel, −1 where there is nothing; the mesh itself is one part.
function partsSeen(still, level) {
  if (still.parts && still.partsOf === level) return still.parts;
  const { pixels, cells } = still,
    parts = new Int32Array(pixels.length);
  for (let at = 0; at < parts.length; at++)
    parts[at] = !pixels[at] ? -1 : level ? level.labels[cells[pixels[at] - 1]] : 0;
  return Object.assign(still, { parts, partsOf: level }).parts;
}

// Call ``found`` at every pixel whose value differs from that of the next one to the right or below.
function changes(values, width, found) {
  for (let at = 0; at + width < values.length; at++) {
    if (values[at] !== values[at + 1] || values[at] !== values[at + width]) found(at);
  }
}

function inked(bytes, at, ink) {
  for (let k = 0; k < 3; k++) bytes[4 * at + k] = ink[k];
  bytes[4 * at + 3] = 255;
}

function litImage(still, level, tints, withCells) {
  const { pixels, width, height } = still,
    image = new ImageData(width, height),
    bytes = image.data;
  const tones = new Uint8Array(tints.buffer);
  for (let at = 0; at < pixels.length; at++) {
    if (!pixels[at]) continue;
    const tone = 4 * still.cells[pixels[at] - 1],
      light = still.bright[pixels[at] - 1] / 255;
    for (let k = 0; k < 3; k++) bytes[4 * at + k] = tones[tone + k] * light;
    bytes[4 * at + 3] = 255;
  }
  if (withCells && still.covered > CUTS * CUTS * still.cells.length) {
    changes(pixels, width, (at) => {
      for (let k = 0; k < 3; k++) bytes[4 * at + k] *= 0.8;
    });
  }
  changes(partsSeen(still, level), width, (at) => inked(bytes, at, INK));
  return image;
}

// A line, three pixels wide, around what is seen of a part.
function outline(still, level, part) {
  const { width } = still,
    image = new ImageData(width, still.height),
    tone = channels(toneOf("--mark"));
  const own = partsSeen(still, level).map((each) => Number(each === part));
  changes(own, width, (at) => {
    for (const step of [0, 1, -1, width, -width])
      if (at + step >= 0 && at + step < own.length) inked(image.data, at + step, tone);
  });
  return image;
}

// The still in front of the eye, where pixels of the still are the units of the scene.
const easel = document.createElement("canvas");

function placed(context, view, image) {
  Object.assign(easel, { width: image.width, height: image.height });
  easel.getContext("2d").putImageData(image, 0, 0);
  const s = view.scale * view.dots,
    { width, height } = context.canvas;
  context.imageSmoothingQuality = "high";
  context.drawImage(
    easel,
    width / 2 - s * view.x,
    height / 2 - s * view.y,
    s * image.width,
    s * image.height,
  );
}

const scene = {
  upwards: false,
  box(level) {
    const { width, height } = stillOf(level);
    return { x: 0, y: 0, width, height };
  },
  mostZoom: () => 8,
  sees: (level, part) => partsSeen(stillOf(level), level).includes(part),
  cellAt({ x, y }, level) {
    const still = stillOf(level),
      column = Math.floor(x),
      row = Math.floor(y);
    const inside = column >= 0 && column < still.width && row >= 0 && row < still.height;
    const face = inside ? still.pixels[row * still.width + column] : 0;
    return face ? still.cells[face - 1] : OUTSIDE;
  },
  paint(context, view, level, tints, withCells) {
    placed(context, view, litImage(stillOf(level), level, tints, withCells));
    return "";
  },
  mark(context, view, level, part) {
    placed(context, view, outline(stillOf(level), level, part));
  },
};
