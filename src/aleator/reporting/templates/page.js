"use strict";
(() => {
  const config = { displaylogo: false, displayModeBar: false, responsive: true, doubleClick: "reset" };
  const plots = [...document.querySelectorAll(".plot")];
  const content = (plot) =>
    JSON.parse(document.querySelector(`script[data-for="${plot.id}"]`).textContent);

  for (const plot of plots) {
    const { data, layout, frames } = content(plot);
    // Dragging stays with the page on touch screens: there it scrolls.
    layout.dragmode = matchMedia("(pointer: coarse)").matches ? false : "zoom";
    Plotly.newPlot(plot, { data, layout, frames, config });
  }

  // A contents list that fills a phone's first screen would hide the report.
  if (matchMedia("(max-width: 900px)").matches) document.querySelector("nav details").open = false;

  let opened = [];
  addEventListener("beforeprint", () => {
    opened = [...document.querySelectorAll("details:not([open])")];
    for (const one of opened) one.open = true;
    for (const plot of plots) Plotly.relayout(plot, { width: 660, autosize: false });
  });
  addEventListener("afterprint", () => {
    for (const one of opened) one.open = false;
    for (const plot of plots) Plotly.relayout(plot, { width: null, autosize: true });
  });
})();
