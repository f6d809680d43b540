// A table whose heads sort its rows. A column is {name, value(row), show(value), cell(row)}; cell may give a
// whole element instead. Missing values stay at the end either way. ``finish`` gets each line, ``filled`` is
// told of all.
function sortable(table, columns, rows, finish = () => {}, filled = () => {}) {
  const order = { column: null, down: false };
  const compare = (column) => (one, other) => {
    const [a, b] = [column.value(one), column.value(other)];
    const missing = (v) => v === null || v === undefined || Number.isNaN(v);
    if (missing(a) || missing(b)) return missing(a) - missing(b);
    const sign = typeof a === "string" ? a.localeCompare(b) : a - b;
    return order.down ? -sign : sign;
  };
  const fill = () => {
    const sorted = order.column ? [...rows].sort(compare(order.column)) : rows;
    const body = element("tbody");
    for (const row of sorted) {
      const line = element(
        "tr",
        {},
        ...columns.map((column) => column.cell?.(row) ?? element("td", {}, column.show(column.value(row)))),
      );
      finish(line, row);
      body.append(line);
    }
    table.tBodies[0]?.remove();
    table.append(body);
    filled();
  };
  const heads = columns.map((column) => {
    const sort = () => {
      order.down = order.column === column ? !order.down : false;
      order.column = column;
      heads.forEach((head, i) =>
        head.setAttribute(
          "aria-sort",
          columns[i] !== column ? "none" : order.down ? "descending" : "ascending",
        ),
      );
      fill();
    };
    return element(
      "th",
      { scope: "col", "aria-sort": "none" },
      element("button", { type: "button", click: sort }, column.name),
    );
  });
  table.replaceChildren(element("thead", {}, element("tr", {}, ...heads)));
  fill();
}
