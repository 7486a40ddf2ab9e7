// Draws the charts of a page, in the theme that the browser asks for, and again when that changes.
"use strict";

// Plotly offers by default to upload a chart to its makers; a page stays where it is.
const CONFIG = { displaylogo: false, responsive: true, showSendToCloud: false };
const NARROW_PX = 560;
const dark = matchMedia("(prefers-color-scheme: dark)");
const charts = [...document.querySelectorAll(".chart")];
const narrow = (div) => div.clientWidth < NARROW_PX;

async function unpack(id) {
  const text = document.getElementById(id).textContent;
  const bytes = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).text();
}

function specification(div) {
  const style = getComputedStyle(document.documentElement);
  const text = document.querySelector(`[data-chart="${div.id}"]`).textContent;
  const { data, layout } = JSON.parse(
    text.replace(/var\((--[\w-]+)\)/g, (_, name) => style.getPropertyValue(name).trim()),
  );
  // What the reader zoomed, turned or hid stays so.
  layout.uirevision = "kept";
  if (narrow(div)) {
    layout.font.size = 12;
    layout.margin = { ...layout.margin, l: 44, r: 8 };
    layout.height = Math.max(300, 0.9 * layout.height);
    for (const axis of [layout.xaxis, layout.yaxis]) if (axis && !axis.dtick) axis.nticks = 5;
    const eye = layout.scene?.camera?.eye ?? {};
    for (const axis in eye) eye[axis] *= 1.25;
    for (const axis of ["xaxis", "yaxis", "zaxis"]) {
      if (layout.scene?.[axis]) layout.scene[axis].nticks = 4;
    }
  }
  return [data, layout];
}

async function draw(div) {
  await Plotly.react(div, ...specification(div), CONFIG);
  div.style.minHeight = "";
  div.dataset.narrow = narrow(div);
}

// All plots over the time of a flight show the same part of it.
let linking = false;
function link(div) {
  div.on("plotly_relayout", async (change) => {
    const [from, to] = change["xaxis.range"] ?? [change["xaxis.range[0]"], change["xaxis.range[1]"]];
    const whole = change["xaxis.autorange"];
    if (linking || !(whole || from !== undefined)) return;
    linking = true;
    const others = charts.filter((other) => other !== div && other.layout?.meta?.time);
    for (const other of others) {
      const range = whole ? { "xaxis.autorange": true } : { "xaxis.range": [from, to] };
      await Plotly.relayout(other, range);
    }
    linking = false;
  });
}

(async () => {
  const begin = performance.now();
  const script = document.createElement("script");
  script.textContent = await unpack("plotly");
  document.head.append(script);
  for (const div of charts) {
    await draw(div);
    if (div.layout.meta?.time) link(div);
    // The page answers between two charts.
    await new Promise((resolve) => setTimeout(resolve));
  }
  dark.addEventListener("change", () => charts.forEach(draw));
  addEventListener("resize", () => {
    charts.filter((div) => div.dataset.narrow !== String(narrow(div))).forEach(draw);
  });
  document.documentElement.dataset.drawnMs = Math.round(performance.now() - begin);
})();
