"use strict";
// Turns the drawings of space: every drawn thing carries its coordinates in data-p, this script projects them anew.
for (const figure of document.querySelectorAll("figure.space")) {
  const svg = figure.querySelector("svg"), bar = svg.querySelector(".bar"), metre = Number(svg.dataset.metre);
  const first = svg.dataset.view.split(" ").map(Number);
  const things = [...svg.querySelectorAll("[data-p]")].map(one => [one, one.dataset.p.split(" ").map(v => v / 1e4)]);
  const corner = [...svg.querySelectorAll("[data-d]")].map(one => [one, one.dataset.d.split(" ").map(Number)]);
  const names = [...svg.querySelectorAll(".place text, .end text")];
  let [turn, tilt] = first, size = 0, width = 0, height = 0, waiting = false;
  figure.classList.add("live");
  const length = size => size >= 1000 ? `${size / 1000} km` : size >= 1 ? `${size} m`
    : size >= 1e-3 ? `${Number((size * 1e3).toPrecision(3))} mm` : `${Number((size * 1e6).toPrecision(3))} µm`;
  const draw = () => {
    waiting = false;
    const before = width;
    width = Math.max(200, svg.parentElement.clientWidth);
    if (width !== before) size = 0;
    height = Math.round(Math.min(Math.max(0.66 * width, 300), 560));
    svg.setAttribute("viewBox", `${-width / 2} ${-height / 2} ${width} ${height}`);
    const a = turn * Math.PI / 180, e = tilt * Math.PI / 180;
    const place = (p, i, by) => [by * (Math.cos(a) * p[i + 1] - Math.sin(a) * p[i]),
      -by * (Math.cos(e) * p[i + 2] - Math.sin(e) * (Math.cos(a) * p[i] + Math.sin(a) * p[i + 1]))];
    if (!size) {
      // As large as the whole fits in, seen from here.
      let wide = 1e-9, high = 1e-9;
      for (const [, p] of things)
        for (let i = 0; i < p.length; i += 3) {
          const [x, y] = place(p, i, 1);
          wide = Math.max(wide, Math.abs(x));
          high = Math.max(high, Math.abs(y));
        }
      size = Math.min(0.45 * width / wide, 0.42 * height / high);
    }
    const text = pair => pair.map(value => value.toFixed(1)).join(" ");
    const show = (one, p, by) => {
      if (one.tagName !== "path") return one.setAttribute("transform", `translate(${text(place(p, 0, by))})`);
      const line = [];
      for (let i = 0; i < p.length; i += 3) line.push(text(place(p, i, by)));
      return one.setAttribute("d", "M" + line.join("L"));
    };
    for (const [one, p] of things) show(one, p, size);
    // Of names that would lie over each other, the first is shown.
    const taken = [];
    for (const name of names) {
      const [x, y] = place(name.parentElement.dataset.p.split(" ").map(v => v / 1e4), 0, size);
      const long = 8 + 7 * name.textContent.length, left = x + long > width / 2;
      name.setAttribute("text-anchor", left ? "end" : "start");
      name.setAttribute("x", left ? -6 : 6);
      const box = left ? [x - long, y - 16, x, y] : [x, y - 16, x + long, y];
      const free = taken.every(b => box[0] > b[2] || box[2] < b[0] || box[1] > b[3] || box[3] < b[1]);
      name.style.display = free ? "" : "none";
      if (free) taken.push(box);
    }
    for (const [one, p] of corner) show(one, p, 26);
    svg.querySelector(".corner").setAttribute("transform", `translate(${width / 2 - 48} ${height / 2 - 44})`);
    const whole = 0.25 * width / (size * metre), power = 10 ** Math.floor(Math.log10(whole));
    const round = power * (whole / power >= 5 ? 5 : whole / power >= 2 ? 2 : 1);
    bar.setAttribute("transform", `translate(${18 - width / 2} ${height / 2 - 18})`);
    bar.querySelector("path").setAttribute("d", `M0 -4V0H${(round * metre * size).toFixed(1)}V-4`);
    bar.querySelector("text").textContent = length(Number(round.toPrecision(1)));
  };
  const soon = () => { if (!waiting) { waiting = true; requestAnimationFrame(draw); } };
  const view = (t, e, by) => {
    turn = t % 360;
    tilt = Math.max(-90, Math.min(90, e));
    size = Math.min(size * by, 50 * width);
    soon();
  };
  const acts = {
    left: () => view(turn - 10, tilt, 1), right: () => view(turn + 10, tilt, 1),
    up: () => view(turn, tilt + 10, 1), down: () => view(turn, tilt - 10, 1),
    nearer: () => view(turn, tilt, 1.25), farther: () => view(turn, tilt, 0.8),
    above: () => view(-90, 90, 0), front: () => view(-90, 0, 0), side: () => view(0, 0, 0),
    first: () => view(first[0], first[1], 0),
  };
  const keys = { ArrowLeft: "left", ArrowRight: "right", ArrowUp: "up", ArrowDown: "down", "+": "nearer", "=": "nearer",
    "-": "farther", Home: "first" };
  svg.addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey || !(event.key in keys)) return;
    event.preventDefault();
    acts[keys[event.key]]();
  });
  for (const button of figure.querySelectorAll("button")) button.addEventListener("click", () => acts[button.name]());
  const held = new Map();
  let apart = 0;
  svg.addEventListener("pointerdown", event => {
    held.set(event.pointerId, event);
    svg.setPointerCapture(event.pointerId);
    apart = 0;
  });
  svg.addEventListener("pointermove", event => {
    const before = held.get(event.pointerId);
    if (!before) return;
    held.set(event.pointerId, event);
    if (held.size === 1) {
      view(turn - 0.5 * (event.clientX - before.clientX), tilt + 0.5 * (event.clientY - before.clientY), 1);
      return;
    }
    const [one, two] = [...held.values()], now = Math.hypot(one.clientX - two.clientX, one.clientY - two.clientY);
    if (apart > 0) view(turn, tilt, now / apart);
    apart = now;
  });
  for (const name of ["pointerup", "pointercancel"])
    svg.addEventListener(name, event => { held.delete(event.pointerId); apart = 0; });
  // A page is scrolled with the wheel; only with Ctrl, or fingers spread on a pad, does the drawing come nearer.
  svg.addEventListener("wheel", event => {
    if (!event.ctrlKey) return;
    event.preventDefault();
    view(turn, tilt, Math.exp(-event.deltaY / 300));
  }, { passive: false });
  addEventListener("resize", soon);
  // Inside details that are closed the width is zero until they open.
  new ResizeObserver(soon).observe(svg.parentElement);
  draw();
}
