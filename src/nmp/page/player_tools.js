// Numbers, bytes, colours, matrices and elements for the player.

function power(n) {
  const digits = '\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079';
  return '10' + (n < 0 ? '\u207b' : '') + String(Math.abs(n)).split('').map(d => digits[+d]).join('');
}
function metres(v) {
  if (v === 0) return '0 m';
  if (v >= 0.1) return v.toPrecision(3) + ' m';
  if (v >= 1e-4) return (1e3 * v).toPrecision(3) + ' mm';
  if (v >= 1e-7) return (1e6 * v).toPrecision(3) + ' \u00b5m';
  return (1e9 * v).toPrecision(3) + ' nm';
}
function seconds(t, whole) {  // as suits a clip of `whole` seconds
  return whole < 10 ? (1e3 * t).toFixed(1) + ' ms' : t.toFixed(3) + ' s';
}
function pascals(high) {  // [name, its size in Pa] of the unit for values up to `high`
  const units = [['GPa', 1e9], ['MPa', 1e6], ['kPa', 1e3], ['Pa', 1]];
  return units.find(unit => high >= unit[1]) || units[3];
}
function short(v) { return String(+v.toPrecision(4)); }
function nice(value) {  // 1, 2 or 5 times a power of ten, near
  const p = Math.pow(10, Math.floor(Math.log10(value)));
  return value / p >= 5 ? 5 * p : value / p >= 2 ? 2 * p : p;
}

function bytes_of(base64) {
  const text = atob(base64), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; ++i) bytes[i] = text.charCodeAt(i);
  return bytes;
}

// One after another for any colour vision. Of errors the least is a middle tone, not a dark one: all
// of them begin without any, and a body without errors should be seen. Lightness rises evenly.
const RAMPS = {
  error: ['#7b96dc', '#5aa3de', '#40afd9', '#38bcce', '#45c5bd', '#5dd5a5', '#86e384', '#bbed62', '#fbef45'],
  det: ['#1b5aa6', '#4393c3', '#92c5de', '#d1e5f0', '#f5f5f3', '#fddbc7', '#f4a582', '#d6604d', '#a81529'],
  stress: ['#d3dce6', '#b3cfdb', '#9fd0bd', '#c8da86', '#f2d158', '#f6a53b', '#ea6b2b', '#c93423', '#8e1420'],
  speed: ['#2a0a8f', '#6300a7', '#9410a2', '#bd3786', '#dd5e66', '#f48849', '#fdb42f', '#f0f042']
};
function texels(stops) {  // 256 colours
  const out = new Uint8Array(4 * 256);
  const colours = stops.map(hex => [1, 3, 5].map(i => parseInt(hex.substr(i, 2), 16)));
  for (let i = 0; i < 256; ++i) {
    const at = i / 255 * (stops.length - 1), k = Math.min(stops.length - 2, Math.floor(at)), f = at - k;
    for (let c = 0; c < 3; ++c) out[4 * i + c] = Math.round(colours[k][c] * (1 - f) + colours[k + 1][c] * f);
    out[4 * i + 3] = 255;
  }
  return out;
}

// -- 4 x 4 matrices by columns; z is up

const FOV = 28 * Math.PI / 180;
function perspective(aspect, near, far) {
  const f = 1 / Math.tan(FOV / 2), d = 1 / (near - far);
  return new Float32Array([f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (near + far) * d, -1, 0, 0, 2 * near * far * d, 0]);
}
function axes(camera) {  // right, up, towards the eye
  const ca = Math.cos(camera.azimuth), sa = Math.sin(camera.azimuth);
  const ce = Math.cos(camera.elevation), se = Math.sin(camera.elevation);
  return [[-sa, ca, 0], [-ca * se, -sa * se, ce], [ca * ce, sa * ce, se]];
}
function look(camera) {
  const a = axes(camera), t = camera.target, m = new Float32Array(16);
  for (let i = 0; i < 3; ++i) {
    for (let k = 0; k < 3; ++k) m[4 * k + i] = a[i][k];
    m[12 + i] = -(a[i][0] * t[0] + a[i][1] * t[1] + a[i][2] * t[2]);
  }
  m[14] -= camera.distance;
  m[15] = 1;
  return m;
}

// Columns of the grid of n panes that makes them largest; a pane may be a little wider than high.
function columns_of(n, width, height) {
  let best = 1, largest = 0;
  for (let c = 1; c <= n; ++c) {
    if (n === 3 && c === 2) continue;  // a quarter would be empty
    const size = Math.min(width / c, 1.2 * height / Math.ceil(n / c));
    if (size > largest * (1 + 1e-9)) { best = c; largest = size; }
  }
  return best;
}

// -- elements

function make(tag, parent, properties, text) {
  const element = document.createElement(tag);
  for (const name in properties || {}) element.setAttribute(name, properties[name]);
  if (text) element.textContent = text;
  if (parent) parent.appendChild(element);
  return element;
}
function segments(parent, label, names, chosen) {
  const box = make('span', parent, {'class': 'segments', role: 'group', 'aria-label': label});
  return names.map((name, i) => {
    const button = make('button', box, {type: 'button'}, name);
    button.addEventListener('click', () => chosen(i));
    return button;
  });
}
function checkbox(parent, label, checked, changed) {
  const box = make('input', make('label', parent), {type: 'checkbox'});
  box.parentNode.appendChild(document.createTextNode(label));
  box.checked = checked;
  box.addEventListener('change', () => changed(box.checked));
  return box;
}
function choice(parent, label, names, chosen) {
  const select = make('select', make('label', parent, {}, label));
  names.forEach((name, i) => make('option', select, {value: i}, name));
  select.addEventListener('change', () => chosen(+select.value));
  return select;
}
function press(buttons, which) {
  buttons.forEach((button, i) => button.setAttribute('aria-pressed', i === which ? 'true' : 'false'));
}
