// Light or dark: as the system has it, unless the button says otherwise.
const DARK = window.matchMedia("(prefers-color-scheme: dark)");
const isDark = () => (document.documentElement.dataset.theme ?? (DARK.matches ? "dark" : "light")) === "dark";

// A colour of page.css by its name, as #rrggbb.
const toneOf = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

function startTheme(changed) {
  const name = () => {
    $("theme").textContent = isDark() ? "Light" : "Dark";
  };
  const tell = () => {
    name();
    changed();
  };
  $("theme").hidden = false;
  $("theme").addEventListener("click", () => {
    document.documentElement.dataset.theme = isDark() ? "light" : "dark";
    tell();
  });
  DARK.addEventListener("change", tell);
  name();
}
