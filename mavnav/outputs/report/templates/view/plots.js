// Plots over time below the map, one strip for each quantity; a click or drag goes to a scan.
"use strict";

const STRIP = 74, GAP = 22, LEFT = 52, RIGHT = 8, TOP = 16; // pixels
const EVERYWHERE = 0.9; // of the log, as in verdicts
const QUANTITIES = [
  { key: "cost", title: "cost [mm²], logarithmic", log: true },
  { key: "speed", title: "speed [m/s]" },
  { key: "error", title: "position error [mm]" },
];

class Plots {
  constructor(canvas, onScan) {
    this.canvas = canvas;
    this.onScan = onScan;
    const seek = (event) => { if (event.buttons) this.seek(event.offsetX); };
    canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); seek(event); });
    canvas.addEventListener("pointermove", seek);
    new ResizeObserver(() => this.layOut()).observe(canvas.parentElement);
  }

  show(run, arrays) {
    this.run = run;
    this.arrays = arrays;
    this.strips = QUANTITIES.map((quantity) => ({ ...quantity, ...limits(arrays[quantity.key], quantity.log) })).filter((strip) => strip.known);
    this.layOut();
  }

  seek(x) {
    const share = Math.min(1, Math.max(0, (x - LEFT) / (this.width - LEFT - RIGHT)));
    this.onScan(scanAt(this.arrays, this.start + share * (this.end - this.start)));
  }

  // Draw everything but the mark once, to a picture that is copied for every scan.
  layOut() {
    if (!this.arrays?.time.length) return;
    this.width = this.canvas.parentElement.clientWidth;
    this.height = TOP + this.strips.length * (STRIP + GAP);
    this.start = this.arrays.time[0];
    this.end = Math.max(this.arrays.time.at(-1), this.start + 1e-3);
    const scale = window.devicePixelRatio || 1;
    this.canvas.width = this.width * scale;
    this.canvas.height = this.height * scale;
    this.canvas.style.height = `${this.height}px`;
    this.drawn = document.createElement("canvas");
    this.drawn.width = this.canvas.width;
    this.drawn.height = this.canvas.height;
    const pen = this.drawn.getContext("2d");
    pen.scale(scale, scale);
    pen.font = "11px system-ui, sans-serif";
    const style = getComputedStyle(this.canvas);
    this.ink = style.getPropertyValue("--ink");
    this.strips.forEach((strip, k) => this.drawStrip(pen, strip, TOP + k * (STRIP + GAP), style));
    this.mark(this.scan ?? 0);
  }

  x(seconds) {
    return LEFT + (seconds - this.start) / (this.end - this.start) * (this.width - LEFT - RIGHT);
  }

  // What holds everywhere marks nothing, neither do weak reasons of doubt.
  isMarked({ kind, from_s, to_s }) {
    const weak = kind === "loop" || (kind === "doubt" && this.run.verdict.word === "good");
    return from_s !== undefined && !weak && to_s - from_s < EVERYWHERE * (this.end - this.start);
  }

  drawStrip(pen, { key, title, log, low, high }, top, style) {
    const y = (value) => top + STRIP * (1 - ((log ? Math.log10(Math.max(value, low)) : value) - scaled(low, log)) / (scaled(high, log) - scaled(low, log)));
    for (const place of this.run.places.filter((each) => this.isMarked(each))) {
      const from = this.x(place.from_s), to = this.x(place.to_s);
      pen.fillStyle = place.kind === "lost" ? "rgb(128 128 128 / .35)" : "rgb(224 32 32 / .16)";
      pen.fillRect(from, top, Math.max(to - from, 3), STRIP);
    }
    pen.strokeStyle = style.getPropertyValue("--line");
    pen.strokeRect(LEFT + 0.5, top + 0.5, this.width - LEFT - RIGHT, STRIP);
    pen.fillStyle = style.getPropertyValue("--muted");
    pen.fillText(title, LEFT, top - 4);
    pen.textAlign = "right";
    pen.fillText(short(high), LEFT - 6, top + 9);
    pen.fillText(short(low), LEFT - 6, top + STRIP);
    pen.textAlign = "left";
    pen.strokeStyle = style.getPropertyValue("--accent");
    pen.beginPath();
    const values = this.arrays[key], time = this.arrays.time;
    for (let k = 0, down = false; k < values.length; k++) {
      if (!Number.isFinite(values[k])) { down = false; continue; }
      pen[down ? "lineTo" : "moveTo"](this.x(time[k]), y(values[k]));
      down = true;
    }
    pen.stroke();
  }

  mark(scan) {
    this.scan = scan;
    if (!this.drawn) return;
    const pen = this.canvas.getContext("2d"), scale = window.devicePixelRatio || 1;
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    pen.drawImage(this.drawn, 0, 0);
    pen.scale(scale, scale);
    pen.strokeStyle = this.ink;
    const x = this.x(this.arrays.time[scan]);
    pen.beginPath();
    pen.moveTo(x, TOP - 4);
    pen.lineTo(x, this.height - GAP + 4);
    pen.stroke();
  }
}

function scaled(value, log) {
  return log ? Math.log10(value) : value;
}

// The range of the finite values; of a logarithmic scale of the positive ones.
function limits(values, log) {
  const known = Float64Array.from(values).filter((value) => Number.isFinite(value) && (!log || value > 0)).sort();
  if (!known.length) return { known: false };
  const low = log ? known[Math.floor(0.02 * known.length)] : Math.min(0, known[0]);
  return { known: true, low, high: Math.max(known.at(-1), low * 1.01, low + 1e-6) };
}

// A number with so many digits, without the sign of what rounds to zero.
function fixed(value, digits) {
  return value.toFixed(digits).replace(/^-(?=[0.]*$)/, "");
}

function short(value) {
  return Number(value.toPrecision(value >= 100 ? 3 : 2)).toString();
}
