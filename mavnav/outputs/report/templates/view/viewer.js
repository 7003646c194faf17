// The page: which run is shown, at which scan, and what mouse, touch and keys do.
"use strict";

const BLINK_MS = 700, REACH_PX = 14, CUT_M = 0.06; // cuts across walls are some 0.08 m apart
const HIDDEN_AT_FIRST = new Set(["walls", "odometry", "loops"]);
const KINDS = { lost: "Track lost", doubt: "Reasons of doubt", ghost: "Ghost walls", differs: "Where the maps differ", loop: "Loops closed" };
const OPEN_AT_FIRST = new Set(["lost", "doubt", "ghost", "differs"]);

const $ = (id) => document.getElementById(id);

class Viewer {
  constructor(runs) {
    this.runs = runs;
    this.root = $("view");
    this.root.hidden = false;
    this.root.dataset.ready = "";
    for (const element of this.root.querySelectorAll(".several")) element.hidden = runs.length < 2;
    this.map = makeMap($("map"), Math.min(...runs.map((run) => run.cell_m)));
    this.scanLayer = new ScanLayer(this.map);
    this.plots = new Plots($("plots"), (scan) => this.goTo(scan));
    const slices = runs.flatMap((run) => run.images.filter((image) => image.colour)); // of the same walls as the hits
    this.hidden = new Set([...HIDDEN_AT_FIRST, ...slices.map((image) => image.id)]);
    this.listen();
    if (new Set(runs.map((run) => run.log)).size > 1) this.listRuns();
  }

  listen() {
    const { map } = this;
    runOptions($("run"), this.runs);
    $("run").onchange = () => this.show(Number($("run").value));
    $("other").onchange = () => this.compare(this.mode ?? "swipe", Number($("other").value));
    for (const mode of ["swipe", "blink"]) $(mode).onclick = () => this.toggle(mode);
    $("divider").oninput = () => this.divide();
    $("fit").onclick = () => this.fit();
    $("full").onclick = () => this.fill();
    $("play").onclick = () => this.play(!this.playing);
    $("scan").oninput = () => this.goTo(Number($("scan").value));
    $("number").onchange = () => this.goTo(this.session(this.scan).first + Number($("number").value));
    map.on("move zoom viewreset", () => this.divide());
    map.on("zoomend", () => { this.root.dataset.zoom = map.getZoom(); this.goTo(this.scan); });
    map.on("mousemove", (event) => this.hover(event));
    map.on("mouseout", () => { $("hover").hidden = true; });
    map.on("click", ({ latlng }) => this.pick(latlng));
    document.addEventListener("keydown", (event) => this.key(event));
  }

  async show(number) {
    const run = this.runs[number], arrays = await unpack(run), other = this.run?.log !== run.log;
    this.second?.remove();
    this.second = null;
    this.first?.remove();
    Object.assign(this, { run, arrays, first: new RunLayers(this.map, run, arrays, 0) });
    this.root.dataset.run = number;
    $("run").value = number;
    [...$("runs").children].forEach((button, k) => button.setAttribute("aria-pressed", k === number));
    $("verdict").className = `verdict ${run.verdict.word}`;
    $("verdict").replaceChildren(tagged("strong", run.verdict.word), run.verdict.reason ? `: ${run.verdict.reason}` : "");
    $("scan").max = Math.max(arrays.time.length - 1, 0);
    const beside = this.runs.filter((each) => each !== run && each.log === run.log);
    runOptions($("other"), this.runs, (each) => beside.includes(each));
    for (const element of this.root.querySelectorAll(".bar .several")) element.hidden = this.runs.length < 2 || (!element.contains($("run")) && !beside.length);
    this.listLayers();
    this.listPlaces();
    this.apply();
    this.plots.show(run, arrays);
    if (other) { this.scan = 0; this.fit(); }
    this.goTo(Math.min(this.scan, arrays.time.length - 1));
    if (this.mode) await this.compare(beside.length ? this.mode : null, Number($("other").value));
    this.root.dataset.ready = "yes";
  }

  // Many logs are a list, of which a click shows a map.
  listRuns() {
    $("runs").replaceChildren(...this.runs.map((run, k) => {
      const button = document.createElement("button");
      button.type = "button";
      button.className = run.verdict.word;
      button.append(tagged("strong", run.verdict.word), tagged("span", `${run.log}, ${run.name}`), tagged("span", run.verdict.reason));
      button.onclick = () => this.show(k);
      return button;
    }));
    $("runs").hidden = false;
  }

  listLayers() {
    const choices = Object.entries(this.first.titles).map(([id, title]) => {
      const label = document.createElement("label"), box = document.createElement("input");
      Object.assign(box, { type: "checkbox", checked: !this.hidden.has(id), name: id });
      box.onchange = () => { this.hidden[box.checked ? "delete" : "add"](id); this.apply(); };
      const key = document.createElement("i");
      key.className = `key ${id} ${this.first.kinds[id] ?? "line"}`;
      if (this.first.colours[id]) key.style.background = this.first.colours[id];
      label.append(box, key, title);
      return label;
    });
    $("layers").replaceChildren(...choices);
    $("layers").querySelector("[name=walls]")?.parentElement.after(widthScale());
  }

  apply() {
    const ids = Object.keys({ ...this.first.titles, ...this.second?.titles });
    const shown = new Set(ids.filter((id) => !this.hidden.has(id)));
    this.first.show(shown);
    this.second?.show(shown);
    this.root.dataset.layers = [...shown].join(" ");
  }

  listPlaces() {
    const groups = Object.entries(KINDS).map(([kind, title]) => {
      const places = this.run.places.filter((place) => place.kind === kind);
      if (!places.length) return "";
      const group = document.createElement("details"), summary = document.createElement("summary"), list = document.createElement("ol");
      group.open = OPEN_AT_FIRST.has(kind) && !(kind === "doubt" && this.run.verdict.word === "good");
      const share = kind === "doubt" && this.run.doubt !== null ? `Doubt ${(100 * this.run.doubt).toFixed(0)} %: reasons` : title;
      summary.textContent = `${share} (${places.length})`;
      list.append(...places.map((place) => this.placeButton(place)));
      group.append(summary, list);
      return group;
    });
    $("places").replaceChildren(...groups);
  }

  placeButton(place) {
    const item = document.createElement("li"), button = document.createElement("button");
    button.type = "button";
    button.className = "place";
    const when = place.from_s === undefined ? "" : place.from_s === place.to_s ? ` at ${place.from_s.toFixed(1)} s` : `, ${place.from_s.toFixed(1)} to ${place.to_s.toFixed(1)} s`;
    button.textContent = place.text + when;
    button.onclick = () => this.look(place);
    item.append(button);
    return item;
  }

  // Show a place: the part of the path between its times, or its surroundings.
  look(place) {
    const { arrays } = this;
    if (place.from_s === undefined) {
      const half = Math.max(1, 0.75 * (place.length_m ?? place.side_m ?? 1));
      this.map.fitBounds([[place.y_m - half, place.x_m - half], [place.y_m + half, place.x_m + half]]);
      return;
    }
    const from = scanAt(arrays, place.from_s), to = scanAt(arrays, place.to_s);
    if (place.kind === "loop" && this.hidden.has("loops")) $("layers").querySelector("[name=loops]").click();
    const ends = place.kind === "loop" ? [from, to] : Array.from({ length: to - from + 1 }, (_, k) => from + k);
    const points = ends.filter((k) => isTracked(arrays, k)).map((k) => [arrays.xy[2 * k + 1], arrays.xy[2 * k]]);
    if (points.length) this.map.fitBounds(L.latLngBounds(points).pad(0.3), { maxZoom: 6.5 });
    this.goTo(place.kind === "loop" ? to : from);
  }

  fit() {
    this.map.fitBounds(boxOf(this.run.window), { animate: false });
  }

  fill() {
    const full = this.root.classList.toggle("full");
    $("full").setAttribute("aria-pressed", full);
    this.map.invalidateSize();
    this.fit();
  }

  goTo(scan) {
    if (!this.arrays?.time.length) return;
    const { arrays } = this;
    this.scan = Math.min(Math.max(scan, 0), arrays.time.length - 1);
    $("scan").value = this.scan;
    this.scanLayer.draw(arrays, this.scan);
    this.plots.mark(this.scan);
    $("number").value = this.scan - this.session(this.scan).first;
    $("when").textContent = this.describe(this.scan);
    this.root.dataset.scan = this.scan;
    this.root.dataset.points = this.scanLayer.points.getLatLngs().length;
    const at = [arrays.xy[2 * this.scan + 1], arrays.xy[2 * this.scan]];
    if (this.playing && isTracked(arrays, this.scan) && !this.map.getBounds().contains(at)) this.map.panTo(at, { animate: false });
  }

  play(on) {
    this.playing = on;
    $("play").textContent = on ? "❚❚" : "▶";
    $("play").setAttribute("aria-label", on ? "Pause" : "Play");
    this.root.dataset.playing = on ? "yes" : "no";
    if (!on) return;
    if (this.scan >= this.arrays.time.length - 1) this.goTo(0);
    let shown = this.arrays.time[this.scan], before = performance.now();
    const step = (now) => {
      if (!this.playing) return;
      shown += (now - before) / 1000 * Number($("speed").value);
      before = now;
      const scan = scanAt(this.arrays, shown);
      if (Math.abs(this.arrays.time[this.scan] - shown) > 1 + 2 * Number($("speed").value)) shown = this.arrays.time[this.scan];
      else if (scan !== this.scan) this.goTo(scan);
      if (this.scan >= this.arrays.time.length - 1) this.play(false);
      else requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  // The nearest scan of the path within reach of a place on the map, and the nearest cut across a wall.
  near({ lng: x, lat: y }) {
    const within = REACH_PX / 2 ** this.map.getZoom();
    return [nearest(this.arrays.xy, 2, x, y, within), nearest(this.arrays.walls, 5, x, y, Math.max(within, CUT_M))];
  }

  hover({ latlng, containerPoint }) {
    if (!this.arrays) return;
    const [scan, wall] = this.near(latlng), readout = $("hover");
    const lines = [`x ${fixed(latlng.lng, 2)}, y ${fixed(latlng.lat, 2)} m`];
    if (wall >= 0) lines.push(`wall ${this.arrays.walls[5 * wall + 3].toFixed(0)} mm thick`);
    if (scan >= 0) lines.push(this.describe(scan));
    readout.textContent = lines.join("\n");
    readout.hidden = false;
    const width = this.map.getSize().x, right = containerPoint.x > width / 2;
    readout.style.cssText = `top:${containerPoint.y + 16}px;${right ? `right:${width - containerPoint.x + 12}px` : `left:${containerPoint.x + 12}px`}`;
  }

  session(scan) {
    return this.run.sessions.findLast(({ first }) => first <= scan);
  }

  describe(scan) {
    const session = this.session(scan);
    return (session.name ? `${session.name}, ` : "") + describe(this.arrays, scan, scan - session.first);
  }

  pick(latlng) {
    const [scan] = this.near(latlng);
    if (scan >= 0) this.goTo(scan);
  }

  toggle(mode) {
    return this.compare(this.mode === mode ? null : mode, Number($("other").value));
  }

  // Show a second run: on the right of a border that can be moved, or both by turns.
  async compare(mode, number) {
    clearInterval(this.blinking);
    this.second?.remove();
    this.second = null;
    this.mode = mode;
    this.first.whole();
    for (const each of ["swipe", "blink"]) $(each).setAttribute("aria-pressed", each === mode);
    $("divider").hidden = mode !== "swipe";
    this.root.dataset.mode = mode ?? "one";
    if (mode && this.runs[number]) {
      this.second = new RunLayers(this.map, this.runs[number], await unpack(this.runs[number]), 1);
      if (mode === "blink") this.blinking = setInterval(() => this.alternate(), BLINK_MS);
    }
    this.apply();
    this.divide();
    this.label(mode ? `${this.run.name} | ${this.runs[number].name}` : "");
  }

  divide() {
    if (this.mode !== "swipe" || !this.second) return;
    const share = Number($("divider").value) / 1000;
    this.first.cut(0, share);
    this.second.cut(share, 1);
    $("divider").style.setProperty("--at", `${100 * share}%`);
  }

  alternate() {
    const first = this.root.dataset.blink !== "first";
    this.root.dataset.blink = first ? "first" : "second";
    this.first.pane.style.visibility = first ? "" : "hidden";
    this.second.pane.style.visibility = first ? "hidden" : "";
    this.label((first ? this.first : this.second).run.name);
  }

  label(text) {
    $("shown").textContent = text;
    $("shown").hidden = !text;
  }

  key(event) {
    const typing = event.target.closest("input:not([type=range], [type=checkbox]), select, textarea, button, summary");
    if (event.ctrlKey || event.metaKey || event.altKey || typing) return;
    const several = !$("other").parentElement.hidden;
    const action = {
      " ": () => this.play(!this.playing), ",": () => this.goTo(this.scan - 1), ".": () => this.goTo(this.scan + 1),
      0: () => this.fit(), f: () => this.fill(), s: () => several && this.toggle("swipe"), b: () => several && this.toggle("blink"),
    }[event.key.toLowerCase()];
    if (action) { event.preventDefault(); action(); }
  }
}

function describe(arrays, k, number) {
  const state = !isTracked(arrays, k) ? "no pose" : arrays.state[k] & DOUBTFUL ? "doubtful" : "accepted";
  const cost = Number.isFinite(arrays.cost[k]) ? `, cost ${short(arrays.cost[k])} mm²` : "";
  const error = Number.isFinite(arrays.error[k]) ? `, error ${arrays.error[k].toFixed(0)} mm` : "";
  const yaw = isTracked(arrays, k) ? `, x ${fixed(arrays.xy[2 * k], 2)}, y ${fixed(arrays.xy[2 * k + 1], 2)} m, yaw ${fixed(arrays.yaw[k] * 180 / Math.PI, 0)}°` : "";
  return `scan ${number}, ${arrays.time[k].toFixed(1)} s: ${state}${yaw}${cost}${error}`;
}

function runOptions(select, runs, wanted = () => true) {
  const logs = new Set(runs.map((run) => run.log)).size;
  const options = runs.map((run, k) => {
    const title = logs > 1 ? `${run.log}, ${run.name}` : run.name;
    return wanted(run) && new Option(run.verdict.word ? `${title}: ${run.verdict.word}` : title, k);
  });
  select.replaceChildren(...options.filter(Boolean));
}

function tagged(name, text) {
  const element = document.createElement(name);
  element.textContent = text;
  return element;
}

function widthScale() {
  const scale = document.createElement("p");
  scale.className = "scale";
  scale.append(...WIDTHS.map(([from, color]) => {
    const part = document.createElement("span");
    part.style.borderColor = color;
    part.textContent = from;
    return part;
  }), "mm");
  return scale;
}

const viewer = new Viewer(JSON.parse($("view-data").textContent));
viewer.show(0);
