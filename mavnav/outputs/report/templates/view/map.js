// The map: Leaflet in meters, and the layers of a run on it.
"use strict";

const SESSIONS = ["#d6009a", "#e08a00", "#0a7d4b", "#7b3fe4", "#c0392b", "#0090a8"]; // one path each
const COLOURS = { doubt: "#e02020", loop: "#0a7d4b", odometry: "#e08a00", truth: "#ff6a00", ghost: "#e00000" };
const WIDTHS = [ // wall thickness from, mm: color
  [0, "#2166ac"], [50, "#4aa5c9"], [75, "#7fbf5a"], [100, "#e8b418"], [150, "#ef6c1a"], [200, "#b2182b"],
];
const CLOSEST_PX = 60; // a cell in pixels when zoomed in fully

const Meters = L.Control.Scale.extend({
  _getRoundNum(number) {
    const power = 10 ** Math.floor(Math.log10(number)), digit = number / power;
    return Number((power * (digit >= 5 ? 5 : digit >= 2 ? 2 : 1)).toPrecision(1));
  },
});

function makeMap(element, cell_m) {
  const map = L.map(element, {
    crs: L.CRS.Simple, zoomSnap: 0.25, zoomDelta: 0.5, wheelPxPerZoomLevel: 120, minZoom: -4,
    maxZoom: Math.ceil(Math.log2(CLOSEST_PX / cell_m)), attributionControl: false,
  });
  new Meters({ imperial: false, maxWidth: 140 }).addTo(map);
  return map;
}

function boxOf([x0, y0, x1, y1]) {
  return [[y0, x0], [y1, x1]];
}

// The layers of a run, each in the panes of the run, so that one can be cut off where another begins.
class RunLayers {
  constructor(map, run, arrays, number) {
    this.map = map;
    this.run = run;
    this.arrays = arrays;
    this.pane = map.createPane(`run${number}`);
    this.pane.style.zIndex = 400 + number;
    this.renderer = L.canvas({ pane: `run${number}`, padding: 0.2 });
    this.titles = {};
    this.colours = {};
    this.kinds = {};
    this.layers = {};
    for (const image of run.images) {
      const className = image.colour ? "slice" : "cells";
      this.kinds[image.id] = className;
      if (image.colour) this.colours[image.id] = image.colour;
      this.put(image.id, image.title, L.imageOverlay(image.src, boxOf(image.box), { pane: `run${number}`, className }));
    }
    this.putLines();
  }

  put(id, title, ...layers) {
    this.titles[id] = title;
    this.layers[id] = L.layerGroup(layers);
  }

  line(latlngs, color, weight, more = {}) {
    return L.polyline(latlngs, { color, weight, interactive: false, renderer: this.renderer, ...more });
  }

  putLines() {
    const { arrays, run } = this, doubtful = (k) => arrays.state[k] & DOUBTFUL;
    if (arrays.walls.length) this.put("walls", "Wall thickness", ...this.wallLines());
    if (arrays.truth.length) this.put("truth", "True walls", this.line(linesOf(arrays.truth), COLOURS.truth, 1.5, { dashArray: "6 5" }));
    if (arrays.odometry?.length) this.put("odometry", "Path by odometry", this.line(linesOf(arrays.odometry), COLOURS.odometry, 1.5));
    run.sessions.forEach(({ name, first }, number) => {
      const lines = linesOf(arrays.xy, (k) => isTracked(arrays, k), first, run.sessions[number + 1]?.first);
      const color = SESSIONS[number % SESSIONS.length];
      this.put(number ? `path${number}` : "path", name ? `Path of ${name}` : "Path", this.line(lines, color, 1.5, { opacity: 0.8 }));
      this.colours[number ? `path${number}` : "path"] = color;
    });
    if (arrays.state.some((_, k) => doubtful(k))) {
      this.put("doubt", "Doubtful path", this.line(linesOf(arrays.xy, doubtful), COLOURS.doubt, 4));
    }
    const loops = run.places.filter((place) => place.kind === "loop");
    if (loops.length) this.put("loops", "Loops", ...loops.map((loop) => this.loopLine(loop)));
    const ghosts = run.places.filter((place) => place.kind === "ghost");
    if (ghosts.length) this.put("ghosts", "Ghost walls", ...ghosts.map((ghost) => this.ghostLine(ghost)));
  }

  // One line of many parts for each class of thickness: a part is the stretch of wall that a cut stands for.
  wallLines() {
    const walls = this.arrays.walls, parts = WIDTHS.map(() => []);
    for (let k = 0; k < walls.length; k += 5) {
      const [x, y, direction, width, length] = walls.subarray(k, k + 5);
      const dx = 0.5 * length * Math.cos(direction), dy = 0.5 * length * Math.sin(direction);
      parts[WIDTHS.findLastIndex(([from]) => width >= from)].push([[y - dy, x - dx], [y + dy, x + dx]]);
    }
    return parts.map((lines, k) => this.line(lines, WIDTHS[k][1], 4, { lineCap: "butt", smoothFactor: 0 }));
  }

  loopLine({ from_s, to_s }) {
    const ends = [from_s, to_s].map((seconds) => scanAt(this.arrays, seconds));
    return this.line(ends.map((k) => [this.arrays.xy[2 * k + 1], this.arrays.xy[2 * k]]), COLOURS.loop, 2);
  }

  ghostLine({ x_m, y_m, length_m, direction_deg }) {
    const angle = direction_deg * Math.PI / 180, half = length_m / 2;
    const dx = half * Math.cos(angle), dy = half * Math.sin(angle);
    return this.line([[y_m - dy, x_m - dx], [y_m + dy, x_m + dx]], COLOURS.ghost, 5, { opacity: 0.7 });
  }

  show(shown) {
    for (const [id, layer] of Object.entries(this.layers)) {
      if (shown.has(id)) layer.addTo(this.map);
      else layer.remove();
    }
  }

  // Show only what lies between two shares of the width of the map.
  cut(from, to) {
    const { x: width, y: height } = this.map.getSize();
    const a = this.map.containerPointToLayerPoint([width * from, 0]);
    const b = this.map.containerPointToLayerPoint([width * to, height]);
    this.pane.style.clip = `rect(${a.y}px,${b.x}px,${b.y}px,${a.x}px)`;
  }

  whole() {
    this.pane.style.clip = "";
    this.pane.style.visibility = "";
  }

  remove() {
    this.show(new Set());
    this.renderer.remove();
    this.pane.remove();
  }
}

// The laser at a scan, and what it saw.
class ScanLayer {
  constructor(map) {
    map.createPane("scan").style.zIndex = 450;
    const still = { interactive: false, renderer: L.canvas({ pane: "scan", padding: 0 }), smoothFactor: 0, noClip: true };
    const style = getComputedStyle(map.getContainer());
    this.points = L.polyline([], { ...still, color: style.getPropertyValue("--seen"), weight: 3.5 }).addTo(map);
    this.heading = L.polyline([], { ...still, color: style.getPropertyValue("--ink"), weight: 3 }).addTo(map);
    this.laser = L.circleMarker([0, 0], { ...still, radius: 6, color: "#101418", weight: 2, fillColor: "#ffd400", fillOpacity: 1 });
    this.map = map;
  }

  // A point is a line of no length with round ends: one path for all points is fast.
  draw(arrays, k) {
    const [x, y, yaw] = [arrays.xy[2 * k], arrays.xy[2 * k + 1], arrays.yaw[k]];
    this.points.setLatLngs(pointsOf(arrays, k).map((point) => [point, point]));
    if (!Number.isFinite(x)) {
      this.heading.setLatLngs([]);
      this.laser.remove();
      return;
    }
    const length = 22 / 2 ** this.map.getZoom();
    this.heading.setLatLngs([[y, x], [y + length * Math.sin(yaw), x + length * Math.cos(yaw)]]);
    this.laser.setLatLng([y, x]).addTo(this.map).bringToFront();
  }
}
