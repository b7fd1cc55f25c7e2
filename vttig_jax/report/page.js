"use strict";
// Draws the charts one after the other. Their colours are those of the style sheet, which reaches
// into the shadow trees of Bokeh only by a sheet of its own: so they follow light, dark and print.
const colours = {"#3f90da": "a", "#bd1f01": "b", "#94a4a2": "band", "#832db6": "mark", "#444444": "fit", "#e5e5e5": "grid", "#888888": "axis"};
const written = colour => [colour, `rgb(${[1, 3, 5].map(at => parseInt(colour.slice(at, at + 2), 16))})`];
const rules = Object.entries(colours).flatMap(([colour, name]) => written(colour).map(value =>
  `[fill="${value}"]{fill:var(--${name})}[stroke="${value}"]{stroke:var(--${name})}`)).join("") +
  '[stroke="#444444"]{stroke-width:.8px}[stroke="#3f90da"],[stroke="#bd1f01"]{stroke-width:1.4px}' +
  "@media print{.bk-ToolbarPanel,.bk-Toolbar{display:none!important}}";
function dress(node) {
  for (const child of node.querySelectorAll("*")) {
    if (child.shadowRoot === null) continue;
    const sheet = document.createElement("style");
    sheet.textContent = rules;
    child.shadowRoot.append(sheet);
    dress(child.shadowRoot);
  }
}
async function draw() {
  Bokeh.logger.set_level("error");
  for (const item of JSON.parse(document.getElementById("charts").textContent)) {
    await Bokeh.embed.embed_item(item);
    dress(document.getElementById(item.target_id));
  }
  document.documentElement.dataset.drawn = "yes";
}
draw();
