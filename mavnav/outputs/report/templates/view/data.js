// Runs as the page brings them: typed arrays that are compressed as one, and what is computed from them.
"use strict";

const TYPES = { u1: Uint8Array, u2: Uint16Array, i4: Int32Array, f4: Float32Array, f8: Float64Array };
const TRACKED = 1, DOUBTFUL = 2;
const MAX_GAP_PERIODS = 5; // no speed is computed across longer gaps

// Unpack the arrays of a run once.
async function unpack(run) {
  run.arrays_of ??= unpackOnce(run);
  return run.arrays_of;
}

async function unpackOnce(run) {
  const packed = Uint8Array.from(atob(run.bytes), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const buffer = await new Response(stream).arrayBuffer();
  const arrays = {};
  for (const [name, [type, offset, length]] of Object.entries(run.arrays)) {
    arrays[name] = new TYPES[type](buffer, offset, length);
  }
  if (arrays.range) undoDifferences(arrays.range, arrays.bearing.length);
  arrays.speed = speeds(arrays);
  run.bytes = null;
  return arrays;
}

function undoDifferences(ranges, beams) {
  for (let k = 0; k < ranges.length; k++) {
    if (k % beams) ranges[k] += ranges[k - 1];
  }
}

function isTracked(arrays, k) {
  return (arrays.state[k] & TRACKED) && Number.isFinite(arrays.xy[2 * k]);
}

// Speed between the scans before and after each, m/s; NaN beside gaps.
function speeds({ time, xy }) {
  const period = (time[time.length - 1] - time[0]) / Math.max(time.length - 1, 1);
  return Float32Array.from(time, (_, k) => {
    const took = time[k + 1] - time[k - 1];
    const far = Math.hypot(xy[2 * k + 2] - xy[2 * k - 2], xy[2 * k + 3] - xy[2 * k - 1]);
    return took > 0 && took < MAX_GAP_PERIODS * period ? far / took : NaN;
  });
}

// The scan at a time, or the next one.
function scanAt(arrays, seconds) {
  let low = 0, high = arrays.time.length - 1;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (arrays.time[middle] < seconds) low = middle + 1;
    else high = middle;
  }
  return low;
}

// The points that a scan saw, as [y, x] in the map.
function pointsOf(arrays, k) {
  const row = arrays.row ? arrays.row[k] : -1;
  if (row < 0 || !isTracked(arrays, k)) return [];
  const beams = arrays.bearing.length, points = [];
  const x = arrays.xy[2 * k], y = arrays.xy[2 * k + 1], yaw = arrays.yaw[k];
  for (let beam = 0; beam < beams; beam++) {
    const range = arrays.range[row * beams + beam] / 1000, angle = yaw + arrays.bearing[beam];
    if (range > 0) points.push([y + range * Math.sin(angle), x + range * Math.cos(angle)]);
  }
  return points;
}

// Lines of [y, x] from points x, y one after the other, broken where `keep` says no or a value is not finite.
function linesOf(xy, keep = () => true, from = 0, to = xy.length / 2) {
  const lines = [];
  let line = [];
  for (let k = from; k < to; k++) {
    if (keep(k) && Number.isFinite(xy[2 * k])) line.push([xy[2 * k + 1], xy[2 * k]]);
    else if (line.length) { lines.push(line); line = []; }
  }
  if (line.length) lines.push(line);
  return lines;
}

// The nearest of points x, y (every `stride` numbers) within a distance, -1 for none.
function nearest(xy, stride, x, y, within) {
  let best = -1, least = within * within;
  for (let k = 0; k * stride < xy.length; k++) {
    const dx = xy[k * stride] - x, dy = xy[k * stride + 1] - y, square = dx * dx + dy * dy;
    if (square < least) { least = square; best = k; }
  }
  return best;
}
