
/** A front linked with its designs: a click on a point, or a choice in the table, shows the design beside it. */
function link(figure) {
  const choices = dataFor(figure);
  const buttons = [...figure.querySelectorAll("input[type=radio]")];
  const plots = [...figure.querySelectorAll(".chooser .plot")];
  const bands = [...figure.querySelectorAll(".chosen .plot")];
  // A page that draws its figures on scroll may link them before.
  for (const plot of [...plots, ...bands]) if (!plot.data) draw(plot);
  const paths = bands.map((plot) => dataFor(plot).layout.meta);
  const name = figure.querySelector(".chosen-name");

  function show(place) {
    const choice = choices[place];
    buttons[place].checked = true;
    const box = figure.querySelector(".chooser .table-box");
    box.scrollTop = buttons[place].closest("tr").offsetTop - box.clientHeight / 2;
    name.querySelector("strong").textContent = choice.name;
    figure.querySelector(".facts").replaceChildren(...choice.facts.flatMap(factsOf));
    bands.forEach((plot, i) => showBand(plot, choice.bands[paths[i]]));
    for (const plot of plots) mark(plot, place);
  }

  buttons.forEach((button, place) => {
    button.addEventListener("change", () => show(place));
    button.closest("tr").addEventListener("click", () => show(place));
  });
  for (const plot of plots) {
    Plotly.addTraces(plot, ring());
    plot.on("plotly_click", ({ points }) => {
      const place = points.map((point) => point.data.meta?.[point.pointNumber]).find(Number.isInteger);
      if (place === undefined) return;
      show(place);
      // Under the figures, where the screen is narrow.
      name.scrollIntoView({ block: "nearest" });
    });
  }
  show(buttons.findIndex((button) => button.checked));
}

/** The facts of one kind as a table of two columns, and a note on them. */
function factsOf({ caption, rows, note }) {
  const table = element("table");
  table.append(element("caption", caption));
  for (const [name, ...values] of rows) {
    const row = table.insertRow();
    const head = element("th", name);
    head.scope = "row";
    row.append(head, ...values.map((value) => element("td", value)));
  }
  const below = note ? [element("p", note)] : [];
  for (const one of below) one.className = "note";
  return [table, ...below];
}

function element(tag, text = "") {
  const made = document.createElement(tag);
  made.textContent = text;
  return made;
}

/** A path of the chosen design with its limits, on axes that suit all designs; hidden where it has none. */
function showBand(plot, band) {
  plot.closest(".panel").hidden = !band;
  if (band) Plotly.react(plot, band.data, { ...plot.layout, ...band.layout });
}

function ring() {
  const marker = { symbol: "circle-open", size: 19, color: "#1b2733", line: { width: 2.5 } };
  return { x: [null], y: [null], mode: "markers", marker, hoverinfo: "skip", showlegend: false, cliponaxis: false };
}

/** Move the ring, which is the last trace, to the chosen point; hide it where a figure has no such point. */
function mark(plot, place) {
  const traces = plot._fullData.slice(0, -1);
  const spots = traces.map(({ x, y, meta }) => ({ x, y, i: meta?.indexOf(place) ?? -1 }));
  const spot = spots.find(({ y, i }) => i >= 0 && Number.isFinite(y[i]));
  const at = spot ? { x: [[spot.x[spot.i]]], y: [[spot.y[spot.i]]] } : { x: [[null]], y: [[null]] };
  Plotly.restyle(plot, at, [traces.length]);
}
