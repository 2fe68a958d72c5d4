"use strict";

const CONFIG = { displaylogo: false, displayModeBar: false, responsive: true, doubleClick: "reset" };

/** The data that the page holds for an element. */
function dataFor(element) {
  return JSON.parse(document.querySelector(`script[data-for="${element.id}"]`).textContent);
}

/** Plotly is read when the first figure is drawn: before, a page can be read and scrolled. */
function library() {
  if (window.Plotly) return;
  const script = document.createElement("script");
  script.text = document.querySelector("[data-library]").textContent;
  document.head.append(script);
}

function draw(plot) {
  library();
  const { data, layout, frames } = dataFor(plot);
  // The instants of many histories are written once.
  for (const trace of data) if (trace.repeated) trace.x = Array(trace.repeated).fill(trace.x).flat();
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
  // A figure is drawn when it is about to be seen, and all of them before the page is printed.
  const waiting = new Set(document.querySelectorAll(".drawing, .linked"));
  const show = (figure) => {
    if (!waiting.delete(figure)) return;
    if (figure.matches(".linked")) link(figure);
    else for (const plot of figure.querySelectorAll(".plot")) draw(plot);
  };
  const watcher = new IntersectionObserver(
    (entries) => entries.filter((one) => one.isIntersecting).forEach((one) => show(one.target)),
    { rootMargin: "600px 0px" },
  );
  for (const figure of waiting) watcher.observe(figure);
  // A contents list that fills a phone's first screen would hide the report.
  if (matchMedia("(max-width: 900px)").matches) document.querySelector("nav details").open = false;
  addEventListener("beforeprint", () => [...waiting].forEach(show));
  fitToPaper([...document.querySelectorAll(".plot")]);
});
