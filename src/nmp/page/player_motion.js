// The bodies and motions of a document (player_data.h says how they are stored), on one clock.

// Stored frame k of a motion, of n vertices: 8 n bytes of positions, det F and speed, then 2 n of
// error and stress, padded to 4.
function frame_bytes(n) { return 4 * Math.ceil(10 * n / 4); }

function read_body(json) {
  return {
    n: json.vertices,
    triangles: new Uint32Array(bytes_of(json.triangles).buffer),
    edges: new Uint32Array(bytes_of(json.edges).buffer),
    pinned: new Uint32Array(json.pinned),
    ground: json.ground,
    stress: json.stress,
    law: json.law
  };
}

// A motion as it is drawn: bytes, and the normals of every vertex in every frame, which are not
// stored. `times` in seconds.
function read_motion(json, body) {
  const bytes = bytes_of(json.data);
  return {
    label: json.label, body, low: json.low, size: json.size, frames: json.frames, rmse: json.rmse,
    h: json.h, diverged: json.diverged, times: json.frames.map(t => t * json.h),
    compared: json.rmse.some(v => v !== null), bytes, normals: normals_of(bytes, json, body)
  };
}

// 4 bytes per vertex and frame. A vertex on a crease (of the first frame) has none, (0, 0, 0): the
// others of a triangle then tell its normal.
function normals_of(bytes, json, body) {
  const n = body.n, stride = frame_bytes(n), triangles = body.triangles, [sx, sy, sz] = json.size;
  const normals = new Int8Array(4 * n * json.frames.length), sum = new Float32Array(3 * n);
  const faces = new Float32Array(triangles.length);
  let crease = null;
  for (let k = 0; k < json.frames.length; ++k) {
    const q = new Uint16Array(bytes.buffer, k * stride, 4 * n);
    sum.fill(0);
    for (let i = 0; i < triangles.length; i += 3) {
      const a = triangles[i], b = triangles[i + 1], c = triangles[i + 2];
      const ux = sx * (q[4 * b] - q[4 * a]), uy = sy * (q[4 * b + 1] - q[4 * a + 1]), uz = sz * (q[4 * b + 2] - q[4 * a + 2]);
      const vx = sx * (q[4 * c] - q[4 * a]), vy = sy * (q[4 * c + 1] - q[4 * a + 1]), vz = sz * (q[4 * c + 2] - q[4 * a + 2]);
      const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
      faces[i] = nx; faces[i + 1] = ny; faces[i + 2] = nz;
      for (let j = i; j < i + 3; ++j) {
        const at = 3 * triangles[j];
        sum[at] += nx; sum[at + 1] += ny; sum[at + 2] += nz;
      }
    }
    crease = crease || creases(triangles, faces, sum, n);
    for (let i = 0; i < n; ++i) {
      if (crease[i]) continue;
      const scale = 127 / (Math.hypot(sum[3 * i], sum[3 * i + 1], sum[3 * i + 2]) || 1);
      for (let c = 0; c < 3; ++c) normals[4 * (k * n + i) + c] = Math.round(scale * sum[3 * i + c]);
    }
  }
  return normals;
}

// 1 for vertices around which a triangle is turned by more than 37 degrees from their mean.
function creases(triangles, faces, sum, n) {
  const crease = new Uint8Array(n);
  for (let i = 0; i < triangles.length; ++i) {
    const f = i - i % 3, v = 3 * triangles[i];
    const dot = faces[f] * sum[v] + faces[f + 1] * sum[v + 1] + faces[f + 2] * sum[v + 2];
    const lengths = Math.hypot(faces[f], faces[f + 1], faces[f + 2]) * Math.hypot(sum[v], sum[v + 1], sum[v + 2]);
    if (dot < 0.8 * lengths) crease[triangles[i]] = 1;
  }
  return crease;
}

// Where a motion is at time t: the stored frames around it, the part of the way between them, and
// whether it has ended before.
function moment(motion, t) {
  const times = motion.times, last = times.length - 1;
  let low = 0, high = last;
  while (low < high) {  // the last frame that is not after t
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= t + 1e-9 * motion.h) low = middle; else high = middle - 1;
  }
  const next = Math.min(last, low + 1), span = times[next] - times[low];
  const part = span > 0 ? Math.min(1, Math.max(0, (t - times[low]) / span)) : 0;
  return {k: low, next, part, near: part < 0.5 ? low : next, ended: t > times[last] + 1e-6 * motion.h};
}

// All times at which a motion has a stored frame.
function clock_of(motions) {
  const all = motions.flatMap(m => m.times).sort((a, b) => a - b);
  const same = 1e-6 * Math.min(...motions.map(m => m.h));
  return all.filter((t, i) => i === 0 || t - all[i - 1] > same);
}

// The box around the motions, from their own boxes, and a length in it: of an edge.
function home_of(motions) {
  const low = [0, 1, 2].map(c => Math.min(...motions.map(m => m.low[c])));
  const high = [0, 1, 2].map(c => Math.max(...motions.map(m => m.low[c] + m.size[c])));
  const radius = Math.hypot(...high.map((v, c) => v - low[c])) / 2 || 1;
  return {target: low.map((v, c) => (v + high[c]) / 2), radius, distance: 0, spacing: nice(radius / 2)};
}
function edge_length(motion) {  // on average, in the first frame
  const q = new Uint16Array(motion.bytes.buffer, 0, 4 * motion.body.n), edges = motion.body.edges;
  let sum = 0;
  for (let i = 0; i < edges.length; i += 2)
    sum += Math.hypot(...[0, 1, 2].map(c => motion.size[c] / 65535 * (q[4 * edges[i] + c] - q[4 * edges[i + 1] + c])));
  return 2 * sum / Math.max(1, edges.length);
}
