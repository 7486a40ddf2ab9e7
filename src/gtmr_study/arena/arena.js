// Shows the trials of the point that a reader points at, beside the chart of each world.
"use strict";

(async () => {
  const read = (id) => JSON.parse(document.getElementById(id).textContent);
  const worlds = read("arena-trials");
  while (!document.documentElement.dataset.drawnMs) {
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
  for (const [number, { cells, first }] of worlds.entries()) {
    const [points, trials] = [0, 1].map((k) => document.getElementById(`world-${number}-${k}`));
    const chosen = document.getElementById(`cell-${number}`);
    const list = document.getElementById(`worst-${number}`);
    const text = document.querySelector(`[data-chart="${trials.id}"]`);
    const show = async (name) => {
      const cell = cells[name];
      if (!cell || text.dataset.cell === name) return;
      text.dataset.cell = name;
      chosen.value = name;
      // What the page draws again in another theme is this text.
      const spec = JSON.parse(text.textContent);
      Object.assign(spec.data[0], {
        x: cell.rms_mm,
        y: cell.least_m,
        name,
        text: cell.trial.map((trial, k) => {
          const said = `trial ${trial}: least ${cell.least_m[k].toFixed(3)} m`;
          return `${said}, RMS ${cell.rms_mm[k]} mm`;
        }),
      });
      spec.data[0].marker.color = cell.colour;
      text.textContent = JSON.stringify(spec);
      list.replaceChildren(
        ...cell.worst.map(({ trial, least_m, file, command }) => {
          const item = document.createElement("li");
          const link = Object.assign(document.createElement("a"), { href: file });
          link.textContent = `trial ${trial}, ${least_m.toFixed(3)} m`;
          const code = Object.assign(document.createElement("code"), { className: "command" });
          code.textContent = command;
          item.append(link, ": ", code);
          return item;
        }),
      );
      await draw(trials);
    };
    for (const event of ["plotly_hover", "plotly_click"]) {
      points.on(event, ({ points: [point] }) => show(point.customdata));
    }
    chosen.addEventListener("change", () => show(chosen.value));
    await show(first);
  }
  document.documentElement.dataset.trials = "shown";
})();
