// Files that the page makes by itself: tables and labels as CSV (RFC 4180).
const quoted = (text) => (/[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);

// A number in full: the seven digits that a float32 has, what is missing as nothing.
function plain(value) {
  if (value === null || value === undefined || Number.isNaN(value)) return "";
  return typeof value === "number" && !Number.isInteger(value)
    ? String(Number(value.toPrecision(7)))
    : quoted(String(value));
}

const csv = (head, rows) => `${[head, ...rows].map((row) => row.map(plain).join(",")).join("\r\n")}\r\n`;

// A table of columns as in tables.js.
const tableCsv = (columns, rows) =>
  csv(
    columns.map(({ name }) => name),
    rows.map((row) => columns.map(({ value }) => value(row))),
  );

// Agglomerate of every cell of the mesh, in the order of its numbers, a column for each level.
function labelsCsv(run) {
  const places = new Uint32Array(REPORT.cells);
  REPORT.order.forEach((cell, place) => {
    places[cell] = place;
  });
  const rows = Array.from(places, (place, cell) => [cell, ...run.levels.map((level) => level.labels[place])]);
  return csv(["cell", ...run.levels.map((_, place) => `level ${place}`)], rows);
}

const fileName = (...words) =>
  `${
    words
      .join("-")
      .replace(/[^\p{L}\p{N}.]+/gu, "-")
      .replace(/^-+|-+$/g, "") || "agglo"
  }.csv`;

function download(name, text) {
  const address = URL.createObjectURL(new Blob([text], { type: "text/csv;charset=utf-8" }));
  const link = element("a", { download: name });
  link.setAttribute("href", address);
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}
