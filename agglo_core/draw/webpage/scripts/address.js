// What is shown, in the address: #run=metis&level=2&hover=7&colour=value:CR&right=kmeans&right-level=2
function remember() {
  const [left, right] = state.panels,
    words = new URLSearchParams({ run: runOf(left).name, level: left.level });
  if (left.part !== null) words.set("hover", left.part);
  if (state.choice.key !== "part") words.set("colour", state.choice.key);
  if (state.two) words.set("right", runOf(right).name);
  if (state.two) words.set("right-level", right.level);
  if (REPORT.stills) words.set("view", $("side").value);
  history.replaceState(null, "", `#${words}`);
}

function recall() {
  if (location.hash.length < 2) return;
  const words = new URLSearchParams(location.hash.slice(1)),
    whole = (name) => Number.parseInt(words.get(name), 10);
  const runNamed = (name) =>
    REPORT.runs.findIndex((run) => run.name === words.get(name) && run.levels.length);
  const [left, right] = state.panels;
  if (runNamed("run") >= 0) left.run = runNamed("run");
  if (words.has("level")) left.level = right.level = whole("level") || 0;
  left.part = words.has("hover") ? whole("hover") : null;
  state.two = words.has("right");
  if (runNamed("right") >= 0) right.run = runNamed("right");
  if (words.has("right-level")) right.level = whole("right-level") || 0;
  state.choice = CHOICES.find(({ key }) => key === words.get("colour")) ?? CHOICES[0];
  if ([...$("side").options].some(({ value }) => value === words.get("view")))
    $("side").value = words.get("view");
}
