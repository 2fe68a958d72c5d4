"use strict";

const CONFIG = { displaylogo: false, displayModeBar: false, responsive: true, doubleClick: "reset" };

/** The data that the page holds for an element. */
function dataFor(element) {
  return JSON.parse(document.querySelector(`script[data-for="${element.id}"]`).textContent);
}

function draw(plot) {
  const { data, layout, frames } = dataFor(plot);
  // Dragging stays with the page on touch screens: there it scrolls.
  layout.dragmode = matchMedia("(pointer: coarse)").matches ? false : "zoom";
  Plotly.newPlot(plot, { data, layout, frames, config: CONFIG });
}

/** Figures take the width of the paper, and folded parts open, as long as the page is printed. */
function fitToPaper(plots) {
  let opened = [];
  addEventListener("beforeprint", () => {
    opened = [...document.querySelectorAll("details:not([open])")];
    for (const one of opened) one.open = true;
    for (const plot of plots) Plotly.relayout(plot, { width: 640, autosize: false });
  });
  addEventListener("afterprint", () => {
    for (const one of opened) one.open = false;
    for (const plot of plots) Plotly.relayout(plot, { width: null, autosize: true });
  });
}

addEventListener("DOMContentLoaded", () => {
  const plots = [...document.querySelectorAll(".plot")];
  for (const plot of plots) draw(plot);
  for (const figure of document.querySelectorAll(".linked")) link(figure);
  // A contents list that fills a phone's first screen would hide the report.
  if (matchMedia("(max-width: 900px)").matches) document.querySelector("nav details").open = false;
  fitToPaper(plots);
});
