// The scene of a report: draws the motions that the page carries with Plotly, at the time of a slider.
"use strict";
(async () => {
  const stage = document.getElementById("stage"), film = document.getElementById("film");
  if (!document.createElement("canvas").getContext("webgl")) { // the message in the stage remains
    stage.style.height = "auto";
    return;
  }
  const unpacked = async (id) => {
    const bytes = Uint8Array.from(atob(document.getElementById(id).textContent), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).text();
  };
  const script = document.createElement("script");
  script.textContent = await unpacked("plotly");
  document.head.append(script);
  const data = JSON.parse(await unpacked("motions"));

  stage.replaceChildren();
  film.hidden = false;
  const [button, slider, clock, choice] = film.querySelectorAll("button,input,output,select");
  const names = Object.keys(data.motions), last = data.times.length - 1, seconds = 8;
  const decimals = Math.max(0, 2 - Math.floor(Math.log10(data.times[last] - data.times[0] || 1)));
  const hue = { x: "#0072b2", y: "#d55e00", z: "#009e73", keep: "#cc79a7", plume: "#e69f00" };
  let shown = data.motions[names[0]], now = 0, begun = null;

  // --- vectors
  const add = (a, b, factor = 1) => a.map((v, i) => v + factor * b[i]);
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => { const n = Math.hypot(...a); return n > 0 ? a.map((v) => v / n) : a; };
  const columns = (points) => ({ x: points.map((p) => p[0]), y: points.map((p) => p[1]), z: points.map((p) => p[2]) });

  // --- what does not move
  const common = { hoverinfo: "skip", showlegend: true };
  const line = (name, color, width, more = {}) =>
    ({ type: "scatter3d", mode: "lines", name, line: { color, width, ...more }, x: [], y: [], z: [], ...common });
  const skin = (name, points, color, opacity) =>
    ({ type: "surface", name, x: points[0], y: points[1], z: points[2], opacity, showscale: false,
      colorscale: [[0, color], [1, color]], contours: { x: { highlight: false }, y: { highlight: false }, z: { highlight: false } },
      ...common });
  const still = Object.entries(data.volumes).map(([name, points]) => skin(name, points, hue.keep, 0.35));
  if (data.moves && names.length > 1) {
    const all = { ...line("all runs", "#777777", 1), opacity: 0.35 };
    for (const motion of Object.values(data.motions))
      ["x", "y", "z"].forEach((axis, i) => all[axis].push(...motion.position[i], null));
    still.push(all);
  }

  // --- what moves: each gives its coordinates at an instant
  const at = (k) => shown.position.map((row) => row[k]);
  const frame = (k) => {
    if (!data.turns) return [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
    const [x, y] = shown.axes.map((axis) => axis.map((row) => row[k]));
    return [x, y, cross(x, y)];
  };
  const turned = (vector, axes) => axes.reduce((sum, axis, i) => add(sum, axis, vector[i]), [0, 0, 0]);
  const moving = [];
  if (data.moves) {
    moving.push([line("path", "#777777", 2, { dash: "dash" }), () => columns(shown.position[0].map((_, k) => at(k)))]);
    moving.push([line("path so far", "ink", 5), (k) => columns(shown.position[0].slice(0, k + 1).map((_, i) => at(i)))]);
  }
  const corners = [], [ex, ey, ez] = data.half_edges;
  for (const x of [-1, 1]) for (const y of [-1, 1]) for (const z of [-1, 1]) corners.push([ex * x, ey * y, ez * z]);
  const box = { type: "mesh3d", name: "vehicle", color: "#8a949c", flatshading: true, ...common, x: [], y: [], z: [],
    i: [0, 0, 4, 4, 0, 0, 2, 2, 0, 0, 1, 1], j: [1, 3, 6, 7, 4, 5, 3, 7, 2, 6, 5, 7], k: [3, 2, 7, 5, 5, 1, 7, 6, 6, 4, 7, 3] };
  for (const [name, place] of Object.entries(data.bodies))
    still.push({ ...box, name, color: hue.y, ...columns(corners.map((c) => add(place, c, data.axis))) });
  const dot = { type: "scatter3d", mode: "markers", name: "vehicle", marker: { size: 5, color: "ink" }, ...common };
  moving.push(data.turns
    ? [box, (k) => columns(corners.map((c) => add(at(k), turned(c, frame(k)), data.axis)))]
    : [dot, (k) => columns([at(k)])]);
  if (data.turns)
    ["x", "y", "z"].forEach((axis, i) => moving.push([line("b" + axis, hue[axis], 6),
      (k) => columns([at(k), add(at(k), frame(k)[i], data.axis)])]));
  const ring = [...Array(12).keys()].map((i) => [Math.cos(i * Math.PI / 6), Math.sin(i * Math.PI / 6)]);
  const cone = (root, along, length) => { // opens from the nozzle against the force
    const side = unit(cross(along, Math.abs(along[0]) < 0.8 ? [1, 0, 0] : [0, 1, 0])), other = cross(along, side);
    const end = add(root, along, -length);
    return [root, end, ...ring.map(([c, s]) => add(add(end, side, 0.18 * length * c), other, 0.18 * length * s))];
  };
  if (data.plume) {
    const around = ring.map((_, i) => i);
    const mesh = { type: "mesh3d", name: "plume", color: hue.plume, opacity: 0.85, ...common, x: [], y: [], z: [],
      i: around.flatMap(() => [0, 1]), j: around.flatMap((i) => [2 + i, 2 + i]),
      k: around.flatMap((i) => [2 + (i + 1) % 12, 2 + (i + 1) % 12]) };
    moving.push([mesh, (k) => {
      const force = turned(shown.force.map((row) => row[k]), frame(k));
      return columns(cone(at(k), unit(force), data.plume * Math.hypot(...force)));
    }]);
  }

  // --- the picture
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const title = (axis) => ({ text: data.moves && axis ? axis + (data.unit ? ` (${data.unit})` : "") : "" });
  const range = (i, turn) => (turn ? [data.high[i], data.low[i]] : [data.low[i], data.high[i]]);
  const axis = (i) => ({ title: title(data.labels[i]), range: range(i, data.down && i > 0), gridcolor: colour("--line"),
    zerolinecolor: colour("--line"), showbackground: false, showspikes: false, showticklabels: data.moves && data.labels[i] !== "", nticks: extents[i] < 0.3 * longest ? 2 : 6 });
  const extents = data.high.map((v, i) => v - data.low[i]), longest = Math.max(...extents);
  const distance = () => // narrow windows show less of the width
    0.7 * Math.max(1, 1.4 * stage.clientHeight / stage.clientWidth) * Math.hypot(...extents) / longest;
  let away = distance();
  const layout = () => ({
    margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: "rgba(0,0,0,0)", uirevision: "one",
    font: { color: colour("--ink"), family: "system-ui, sans-serif", size: 12 },
    legend: { orientation: "h", x: 0, y: 0, yanchor: "top" },
    scene: { xaxis: axis(0), yaxis: axis(1), zaxis: axis(2), aspectmode: "manual", uirevision: "one",
      aspectratio: { x: extents[0] / longest, y: extents[1] / longest, z: extents[2] / longest },
      camera: { center: { x: 0, y: 0, z: -0.07 }, eye: { x: 0.75 * away, y: -1.25 * away, z: 0.45 * away } } },
  });
  const first = moving.map((_, i) => still.length + i);
  const inked = (trace) => JSON.parse(JSON.stringify(trace).replaceAll('"ink"', JSON.stringify(colour("--ink"))));
  const traces = () => [...still, ...moving.map(([trace, place]) => ({ ...inked(trace), ...place(now) }))];
  const tell = () => {
    slider.value = now;
    clock.textContent = `t = ${data.times[now].toFixed(decimals)} ${data.time_unit}`;
    slider.setAttribute("aria-valuetext", clock.textContent);
  };
  const draw = () => {
    const places = moving.map(([, place]) => place(now));
    Plotly.restyle(stage, Object.fromEntries(["x", "y", "z"].map((a) => [a, places.map((p) => p[a])])), first);
    tell();
  };
  const whole = () => Plotly.react(stage, traces(), layout(), { responsive: true, displayModeBar: false });

  // --- what one can do
  const pause = () => { begun = null; button.textContent = "Play"; };
  const play = (moment) => {
    if (begun === null) return;
    now = Math.min(last, Math.floor((moment - begun) / 1000 / seconds * last));
    draw();
    if (now < last) requestAnimationFrame(play); else pause();
  };
  button.onclick = () => {
    if (begun !== null) return pause();
    begun = performance.now() - (now < last ? now : 0) / last * seconds * 1000;
    button.textContent = "Pause";
    requestAnimationFrame(play);
  };
  slider.max = last;
  slider.oninput = () => { pause(); now = Number(slider.value); draw(); };
  for (const name of names) choice.add(new Option(name));
  choice.hidden = names.length < 2;
  choice.onchange = () => { shown = data.motions[choice.value]; draw(); };
  addEventListener("resize", () => { // keeps the direction of the view
    if (!stage.clientWidth) return; // not shown in print
    const factor = distance() / away, { eye } = stage.layout.scene.camera;
    away *= factor;
    if (factor !== 1) Plotly.relayout(stage, { "scene.camera.eye": { x: factor * eye.x, y: factor * eye.y, z: factor * eye.z } });
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", whole);
  await whole();
  tell();
  document.getElementById("scene").dataset.ready = "";
})();
