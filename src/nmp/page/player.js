// The 3D player: a recorded trajectory beside its prediction, drawn with WebGL2.
//
// All frames of a trajectory lie in one vertex buffer (player_data.h says how); showing a moment
// means pointing the attributes at the two frames around it, which the vertex shader interpolates.
// Nothing is computed per vertex in here.
(function () {
  'use strict';

  var VERTEX = [
    '#version 300 es',
    'precision highp float;',
    'layout(location = 0) in vec3 x0; layout(location = 1) in vec3 x1;',       // in the box, 0 ... 1
    'layout(location = 2) in vec2 q0; layout(location = 3) in vec2 q1;',       // det F, speed
    'layout(location = 4) in float e0; layout(location = 5) in float e1;',     // error
    'uniform vec3 low, size; uniform mat4 view, projection;',
    'uniform float part, floor_z, bias, point_size; uniform int channel; uniform bool flat_on_floor;',
    'out vec3 eye; out float value;',
    'void main() {',
    '  vec3 x = low + size * mix(x0, x1, part);',
    '  if (flat_on_floor) x.z = floor_z;',
    '  vec4 seen = view * vec4(x, 1.0);',
    '  eye = seen.xyz;',
    '  gl_Position = projection * seen;',
    '  gl_Position.z -= bias * gl_Position.w;',
    '  gl_PointSize = point_size;',
    '  vec2 q = mix(q0, q1, part);',
    '  value = channel == 0 ? mix(e0, e1, part) : channel == 1 ? q.x : q.y;',
    '}'].join('\n');

  // Flat shading: the normal of the triangle from the derivatives of the position.
  var BODY = [
    '#version 300 es',
    'precision highp float;',
    'in vec3 eye; in float value;',
    'uniform sampler2D colours; uniform vec4 plain; uniform bool coloured;',
    'out vec4 colour;',
    'void main() {',
    '  vec3 n = normalize(cross(dFdx(eye), dFdy(eye)));',
    '  if (dot(n, eye) > 0.0) n = -n;',
    '  float light = 0.60 + 0.34 * max(dot(n, normalize(vec3(0.35, 0.75, 0.60))), 0.0)',
    '              + 0.12 * max(n.z, 0.0);',
    '  vec3 base = coloured ? texture(colours, vec2((0.5 + 255.0 * value) / 256.0, 0.5)).rgb : plain.rgb;',
    '  colour = vec4(base * light, 1.0);',
    '}'].join('\n');

  var PLAIN = [
    '#version 300 es',
    'precision highp float;',
    'in vec3 eye; in float value;',
    'uniform vec4 plain; uniform bool round;',
    'out vec4 colour;',
    'void main() {',
    '  if (round && length(gl_PointCoord - 0.5) > 0.5) discard;',
    '  colour = plain;',
    '}'].join('\n');

  var FLOOR_VERTEX = [
    '#version 300 es',
    'precision highp float;',
    'uniform mat4 view, projection; uniform vec3 centre; uniform float extent;',
    'out vec2 at;',
    'void main() {',
    '  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;',
    '  at = centre.xy + extent * corner;',
    '  gl_Position = projection * view * vec4(at, centre.z, 1.0);',
    '}'].join('\n');

  var FLOOR = [
    '#version 300 es',
    'precision highp float;',
    'in vec2 at;',
    'uniform vec3 centre; uniform float extent, spacing; uniform vec4 plain;',
    'out vec4 colour;',
    'void main() {',
    '  vec2 cell = at / spacing;',
    '  vec2 width = max(fwidth(cell), vec2(1e-6));',
    '  vec2 off = abs(fract(cell - 0.5) - 0.5) / width;',
    '  float line = 1.0 - min(min(off.x, off.y), 1.0);',
    '  line *= 1.0 - smoothstep(0.25, 0.7, max(width.x, width.y));',  // no moire far away
    '  float fade = 1.0 - smoothstep(0.35, 1.0, length(at - centre.xy) / extent);',
    '  colour = vec4(plain.rgb, fade * (0.05 + 0.33 * line));',
    '}'].join('\n');

  var MAPS = {
    error: ['#3b1c6e', '#3e4989', '#31688e', '#26828e', '#1f9e89', '#35b779', '#6ece58', '#b5de2b', '#fde725'],
    det: ['#1b5aa6', '#4393c3', '#92c5de', '#d1e5f0', '#f5f5f3', '#fddbc7', '#f4a582', '#d6604d', '#a81529'],
    speed: ['#2a0a8f', '#6300a7', '#9410a2', '#bd3786', '#dd5e66', '#f48849', '#fdb42f', '#f0f042']
  };
  var CHANNELS = ['error', 'det', 'speed'];
  var TITLES = {error: 'error |x \u2212 x*| [m]', det: 'det F', speed: 'speed [m/s]'};
  var SPEEDS = [[1 / 16, '1/16 \u00d7'], [1 / 8, '1/8 \u00d7'], [1 / 4, '1/4 \u00d7'], [1 / 2, '1/2 \u00d7'], [1, 'real time']];
  var FOV = 28 * Math.PI / 180;

  // -- numbers and bytes

  function power(n) {
    var digits = '\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079';
    return '10' + (n < 0 ? '\u207b' : '') + String(Math.abs(n)).split('').map(function (d) { return digits[+d]; }).join('');
  }
  function metres(v) {
    if (v === null) return 'not finite';
    if (v === 0 || v >= 0.1) return v.toPrecision(3) + ' m';
    if (v >= 1e-4) return (1e3 * v).toPrecision(3) + ' mm';
    if (v >= 1e-7) return (1e6 * v).toPrecision(3) + ' \u00b5m';
    return (1e9 * v).toPrecision(3) + ' nm';
  }
  function plain(v) { return String(+v.toPrecision(4)); }
  function bytes_of(base64) {
    var text = atob(base64), bytes = new Uint8Array(text.length);
    for (var i = 0; i < text.length; ++i) bytes[i] = text.charCodeAt(i);
    return bytes;
  }
  function rgb(hex) { return [1, 3, 5].map(function (i) { return parseInt(hex.substr(i, 2), 16); }); }
  function ramp(stops) {  // 256 colours
    var out = new Uint8Array(4 * 256), colours = stops.map(rgb);
    for (var i = 0; i < 256; ++i) {
      var at = i / 255 * (stops.length - 1), k = Math.min(stops.length - 2, Math.floor(at)), f = at - k;
      for (var c = 0; c < 3; ++c) out[4 * i + c] = Math.round(colours[k][c] * (1 - f) + colours[k + 1][c] * f);
      out[4 * i + 3] = 255;
    }
    return out;
  }
  function nice(value) {  // 1, 2 or 5 times a power of ten, near
    var p = Math.pow(10, Math.floor(Math.log10(value)));
    return value / p >= 5 ? 5 * p : value / p >= 2 ? 2 * p : p;
  }

  // -- 4 x 4 matrices by columns; z is up

  function perspective(aspect, near, far) {
    var f = 1 / Math.tan(FOV / 2), d = 1 / (near - far);
    return new Float32Array([f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (near + far) * d, -1, 0, 0, 2 * near * far * d, 0]);
  }
  function axes(camera) {  // right, up, towards the eye
    var ca = Math.cos(camera.azimuth), sa = Math.sin(camera.azimuth), ce = Math.cos(camera.elevation), se = Math.sin(camera.elevation);
    return [[-sa, ca, 0], [-ca * se, -sa * se, ce], [ca * ce, sa * ce, se]];
  }
  function look(camera) {
    var a = axes(camera), t = camera.target, m = new Float32Array(16);
    for (var i = 0; i < 3; ++i) {
      for (var k = 0; k < 3; ++k) m[4 * k + i] = a[i][k];
      m[12 + i] = -(a[i][0] * t[0] + a[i][1] * t[1] + a[i][2] * t[2]);
    }
    m[14] -= camera.distance;
    m[15] = 1;
    return m;
  }

  // -- page

  function make(tag, parent, properties, text) {
    var element = document.createElement(tag);
    for (var name in properties || {}) element.setAttribute(name, properties[name]);
    if (text) element.textContent = text;
    if (parent) parent.appendChild(element);
    return element;
  }
  function segments(parent, label, names, chosen) {
    var box = make('span', parent, {'class': 'segments', role: 'group', 'aria-label': label});
    return names.map(function (name, i) {
      var button = make('button', box, {type: 'button'}, name);
      button.addEventListener('click', function () { chosen(i); });
      return button;
    });
  }
  function press(buttons, which) {
    buttons.forEach(function (b, i) { b.setAttribute('aria-pressed', i === which ? 'true' : 'false'); });
  }

  function start(root) {
    var source = root.querySelector('script'), doc = JSON.parse(source.textContent);
    source.remove();
    var n = doc.vertices, frame_bytes = 16 * n + 4 * Math.ceil(n / 4);
    var state = {track: 0, t: 0, playing: false, speed: 2, channel: 0, overlay: false, edges: true, hold: 0};
    var camera = {azimuth: 0, elevation: 0, distance: 1, target: [0, 0, 0]}, home = null;
    var stats = {draws: 0, script_ms: 0, upload_ms: 0};
    var track = doc.tracks[0], last = 0;

    // 1. Elements.
    var view = make('div', root, {'class': 'player-view', tabindex: '0', role: 'application',
      'aria-label': '3D player: recorded and predicted motion. Space plays, arrow keys step, question mark lists the keys.'});
    var canvas = make('canvas', view, {'aria-hidden': 'true'});
    make('div', view, {'class': 'player-split'});
    var name1 = make('div', view, {'class': 'player-name first'}), name2 = make('div', view, {'class': 'player-name second'});
    var grid_label = make('div', view, {'class': 'player-grid'});
    var message = make('p', view, {'class': 'player-message', role: 'status', hidden: ''});
    var help = make('div', view, {'class': 'player-help', hidden: ''});
    var keys = [['Space', 'play, pause'], ['\u2190 \u2192', 'one stored frame; with Shift ten'], ['Home End', 'first, last frame'],
      ['1 2 3', 'colour: error, det F, speed'], ['o', 'overlay'], ['e', 'edges'], ['+ \u2212', 'faster, slower'], ['r', 'reset the view'], ['?', 'these keys']];
    var list = make('dl', help);
    keys.forEach(function (k) {
      var dt = make('dt', list);
      k[0].split(' ').forEach(function (key, i) { if (i) dt.appendChild(document.createTextNode(' ')); make('kbd', dt, {}, key); });
      make('dd', list, {}, k[1]);
    });
    make('div', help, {}, 'Drag: turn. Shift and drag: move. Wheel, once clicked, or pinch: zoom.');

    var time = make('div', root, {'class': 'player-time'});
    var play = make('button', time, {type: 'button', 'class': 'play', 'aria-label': 'play'});
    var slider = make('input', time, {type: 'range', min: '0', value: '0', step: 'any', 'aria-label': 'frame'});
    var numbers = make('div', root, {'class': 'player-numbers'});
    function number(kind, label) {
      var box = make('div', numbers, {'class': kind}), value = make('b', box);
      make('span', box, {}, label);
      return value;
    }
    var frame_value = number('frame', 'frame'), time_value = number('time', 'time'), rmse_value = number('rmse', 'RMSE');
    var scale = make('div', numbers, {'class': 'player-scale'});
    var scale_title = make('span', scale), gradient = make('div', scale, {'class': 'gradient'}), ticks = make('div', scale, {'class': 'ticks'});

    var settings = make('div', root, {'class': 'player-settings'});
    var chooser = null;
    if (doc.tracks.length > 1) {
      chooser = make('select', make('label', settings, {}, 'trajectory'));
      doc.tracks.forEach(function (t, i) { make('option', chooser, {value: i}, t.name.replace(/\.safetensors$/, '')); });
      chooser.addEventListener('change', function () { choose_track(+chooser.value); });
    }
    var colour_buttons = segments(settings, 'colour', ['error', 'det F', 'speed'], choose_channel);
    var view_buttons = segments(settings, 'view', ['side by side', 'overlay'], function (i) { choose_overlay(i === 1); });
    var edge_box = make('input', make('label', settings), {type: 'checkbox'});
    edge_box.parentNode.appendChild(document.createTextNode('edges'));
    edge_box.checked = true;
    edge_box.addEventListener('change', function () { state.edges = edge_box.checked; request(); });
    var speed_box = make('select', make('label', settings, {}, 'play at'));
    SPEEDS.forEach(function (s, i) { make('option', speed_box, {value: i}, s[1]); });
    speed_box.value = state.speed;
    speed_box.addEventListener('change', function () { state.speed = +speed_box.value; });
    var end = make('span', settings, {'class': 'end'});
    var reset_button = make('button', end, {type: 'button', title: 'r'}, 'reset view');
    var help_button = make('button', end, {type: 'button', 'aria-label': 'keys', 'aria-expanded': 'false'}, '?');
    reset_button.addEventListener('click', reset);
    help_button.addEventListener('click', toggle_help);

    function complain(text) {
      message.textContent = text;
      message.hidden = false;
      [time, numbers, settings, name1, name2, view.querySelector('.player-split'), grid_label].forEach(function (e) { e.hidden = true; });
      canvas.hidden = true;
      view.classList.add('empty');
    }

    // 2. WebGL.
    var gl = canvas.getContext('webgl2', {alpha: true, antialias: true, stencil: true, powerPreference: 'high-performance'});
    root.nmpPlayer = {state: state, stats: stats, camera: camera, document: doc, webgl: !!gl};
    if (!gl) {
      complain('This browser offers no WebGL2, which the player needs. Everything else on this page works without it.');
      return;
    }
    var gpu = null, theme = null;

    function shader(type, text) {
      var s = gl.createShader(type);
      gl.shaderSource(s, text);
      gl.compileShader(s);
      if (!gl.getShaderParameter(s, gl.COMPILE_STATUS) && !gl.isContextLost()) throw new Error(gl.getShaderInfoLog(s));
      return s;
    }
    function program(vertex, fragment) {
      var p = gl.createProgram();
      gl.attachShader(p, shader(gl.VERTEX_SHADER, vertex));
      gl.attachShader(p, shader(gl.FRAGMENT_SHADER, fragment));
      gl.linkProgram(p);
      if (!gl.getProgramParameter(p, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(gl.getProgramInfoLog(p));
      var uniforms = {};
      for (var i = gl.getProgramParameter(p, gl.ACTIVE_UNIFORMS) - 1; i >= 0; --i) {
        var name = gl.getActiveUniform(p, i).name;
        uniforms[name] = gl.getUniformLocation(p, name);
      }
      return {program: p, at: uniforms};
    }
    function indices(values) {
      var buffer = gl.createBuffer();
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, values, gl.STATIC_DRAW);
      return {buffer: buffer, count: values.length};
    }
    function load_gpu() {
      gpu = {body: program(VERTEX, BODY), plain: program(VERTEX, PLAIN), floor: program(FLOOR_VERTEX, FLOOR), maps: {}};
      gpu.triangles = indices(new Uint32Array(bytes_of(doc.triangles).buffer));
      gpu.edges = indices(new Uint32Array(bytes_of(doc.edges).buffer));
      gpu.pinned = indices(new Uint32Array(doc.pinned));
      gpu.nothing = gl.createVertexArray();
      CHANNELS.forEach(function (name) {
        var texture = gl.createTexture();
        gl.bindTexture(gl.TEXTURE_2D, texture);
        gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, ramp(MAPS[name]));
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
        gpu.maps[name] = texture;
      });
      gpu.frames = gl.createBuffer();
      load_frames();
    }
    function load_frames() {
      var begin = performance.now();
      gl.bindBuffer(gl.ARRAY_BUFFER, gpu.frames);
      gl.bufferData(gl.ARRAY_BUFFER, bytes_of(track.data), gl.STATIC_DRAW);
      stats.upload_ms = performance.now() - begin;
    }
    function read_theme() {
      var style = getComputedStyle(root), probe = make('span', root);
      function colour(name) {
        probe.style.color = style.getPropertyValue(name);
        return getComputedStyle(probe).color.match(/[\d.]+/g).slice(0, 3).map(function (c) { return c / 255; });
      }
      theme = {};
      ['body', 'edge', 'floor', 'pin'].forEach(function (name) { theme[name] = colour('--' + name); });
      theme.shadow = +style.getPropertyValue('--shade-alpha');
      probe.remove();
    }

    // 3. Drawing.
    function attributes(k0, k1, predicted) {  // the frames that the shader interpolates
      [k0, k1].forEach(function (k, i) {
        var base = k * frame_bytes, body = base + (predicted ? 8 * n : 0);
        gl.vertexAttribPointer(i, 3, gl.UNSIGNED_SHORT, true, 8, body);
        gl.vertexAttribPointer(2 + i, 2, gl.UNSIGNED_BYTE, true, 8, body + 6);
        gl.vertexAttribPointer(4 + i, 1, gl.UNSIGNED_BYTE, true, 1, base + 16 * n);
      });
    }
    function use(p, common) {
      gl.useProgram(p.program);
      gl.uniformMatrix4fv(p.at.view, false, common.view);
      gl.uniformMatrix4fv(p.at.projection, false, common.projection);
      if (!p.at.low) return;
      gl.uniform3fv(p.at.low, track.low);
      gl.uniform3fv(p.at.size, track.size);
      gl.uniform1f(p.at.part, common.part);
      gl.uniform1i(p.at.channel, state.channel);
      gl.uniform1i(p.at.flat_on_floor, 0);
      gl.uniform1f(p.at.bias, 0);
      gl.uniform1f(p.at.floor_z, doc.ground === null ? 0 : doc.ground);
    }
    function draw(kind, what) {
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, what.buffer);
      gl.drawElements(kind, what.count, gl.UNSIGNED_INT, 0);
    }
    function draw_plain(common, kind, what, colour, alpha, bias) {
      use(gpu.plain, common);
      gl.uniform1f(gpu.plain.at.bias, bias);
      gl.uniform1i(gpu.plain.at.round, kind === gl.POINTS);
      gl.uniform1f(gpu.plain.at.point_size, common.point_size);
      gl.uniform4f(gpu.plain.at.plain, colour[0], colour[1], colour[2], alpha);
      draw(kind, what);
    }
    function draw_body(common, colours) {
      use(gpu.body, common);
      gl.uniform1i(gpu.body.at.coloured, colours ? 1 : 0);
      gl.uniform4f(gpu.body.at.plain, theme.body[0], theme.body[1], theme.body[2], 1);
      gl.bindTexture(gl.TEXTURE_2D, gpu.maps[CHANNELS[state.channel]]);
      draw(gl.TRIANGLES, gpu.triangles);
    }
    function draw_shadow(common) {  // each pixel once
      gl.enable(gl.STENCIL_TEST);
      gl.stencilFunc(gl.EQUAL, 0, 255);
      gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
      gl.depthMask(false);
      use(gpu.plain, common);
      gl.uniform1i(gpu.plain.at.flat_on_floor, 1);
      gl.uniform1i(gpu.plain.at.round, 0);
      gl.uniform4f(gpu.plain.at.plain, 0, 0, 0, theme.shadow);
      draw(gl.TRIANGLES, gpu.triangles);
      gl.depthMask(true);
      gl.disable(gl.STENCIL_TEST);
    }
    function draw_floor(common) {
      use(gpu.floor, common);
      gl.uniform3f(gpu.floor.at.centre, home.target[0], home.target[1], doc.ground);
      gl.uniform1f(gpu.floor.at.extent, 3.2 * home.radius);
      gl.uniform1f(gpu.floor.at.spacing, home.spacing);
      gl.uniform4f(gpu.floor.at.plain, theme.floor[0], theme.floor[1], theme.floor[2], 1);
      gl.bindVertexArray(gpu.nothing);
      gl.depthMask(false);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
      gl.depthMask(true);
      gl.bindVertexArray(null);
    }
    function moment() {  // stored frames around t, and where between them
      var frames = track.frames, k = Math.min(frames.length - 1, Math.floor(state.t / track.stride));
      while (k > 0 && frames[k] > state.t) --k;
      var next = Math.min(frames.length - 1, k + 1), span = frames[next] - frames[k];
      return {k: k, next: next, part: span > 0 ? (state.t - frames[k]) / span : 0};
    }
    function render() {
      var begin = performance.now(), ratio = Math.min(2, window.devicePixelRatio || 1);
      var width = Math.round(view.clientWidth * ratio), height = Math.round(view.clientHeight * ratio);
      if (!width || !height) return;
      if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
      var stacked = matchMedia('(max-width:640px)').matches;
      var w = state.overlay || stacked ? width : Math.floor(width / 2);
      var h = state.overlay || !stacked ? height : Math.floor(height / 2);
      var at = moment(), distance = camera.distance;
      var common = {view: look(camera), part: at.part, point_size: 9 * ratio,
        projection: perspective(w / h, 0.02 * distance, distance + 8 * home.radius)};
      gl.viewport(0, 0, width, height);
      gl.clearColor(0, 0, 0, 0);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
      gl.enable(gl.DEPTH_TEST);
      gl.enable(gl.BLEND);
      gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
      for (var pane = 0; pane < (state.overlay ? 1 : 2); ++pane) {
        var predicted = pane === 1 || state.overlay;
        gl.viewport(stacked ? 0 : pane * (width - w), stacked && !state.overlay && pane === 0 ? height - h : 0, w, h);
        if (doc.ground !== null) draw_floor(common);
        gl.bindBuffer(gl.ARRAY_BUFFER, gpu.frames);
        for (var i = 0; i < 6; ++i) gl.enableVertexAttribArray(i);
        attributes(at.k, at.next, predicted);
        if (doc.ground !== null) draw_shadow(common);
        draw_body(common, predicted || state.channel !== 0);
        if (state.edges && !state.overlay)  // the map of det F is bright in the middle, in the dark too
          draw_plain(common, gl.LINES, gpu.edges, state.channel === 1 ? [0, 0, 0] : theme.edge, 0.22, 2e-4);
        if (gpu.pinned.count) draw_plain(common, gl.POINTS, gpu.pinned, theme.pin, 1, 6e-4);
        if (state.overlay) {  // the record as a net over the prediction
          attributes(at.k, at.next, false);
          draw_plain(common, gl.LINES, gpu.edges, theme.edge, 0.6, 2e-4);
        }
      }
      ++stats.draws;
      stats.script_ms += performance.now() - begin;
    }

    // 4. What is shown.
    function show_numbers() {
      var at = moment(), near = at.part < 0.5 ? at.k : at.next;
      frame_value.textContent = Math.round(state.t) + ' / ' + last;
      time_value.textContent = (1e3 * state.t * track.h).toFixed(1) + ' ms';
      rmse_value.textContent = metres(track.rmse[near]);
      if (document.activeElement !== slider || state.playing) slider.value = state.t;
      slider.setAttribute('aria-valuetext', 'frame ' + Math.round(state.t) + ' of ' + last);
      var held = track.held !== null && state.t > track.held;
      var second = held ? 'diverged after frame ' + track.held + ', held since' : '';
      if (name2.lastChild.textContent !== second) name2.lastChild.textContent = second;
    }
    function show_scale() {
      var name = CHANNELS[state.channel], s = doc.scales[name], marks = [];
      scale_title.textContent = TITLES[name];
      gradient.style.background = 'linear-gradient(90deg,' + MAPS[name].join(',') + ')';
      if (s.log) {
        var from = Math.log10(s.low), to = Math.log10(s.high);
        for (var d = Math.ceil(from - 1e-6); d <= to + 1e-6; ++d) marks.push([(d - from) / (to - from), power(d)]);
      } else {
        for (var i = 0; i <= 4; ++i) marks.push([i / 4, plain(s.low + (s.high - s.low) * i / 4)]);
      }
      if (name === 'det') marks[0][1] = '\u2264 ' + marks[0][1];
      if (name !== 'error') marks[4][1] = '\u2265 ' + marks[4][1];
      ticks.textContent = '';
      marks.forEach(function (m) {  // those at the ends stay inside
        var shift = m[0] < 0.04 ? 0 : m[0] > 0.96 ? -100 : -50;
        make('span', ticks, {style: 'left:' + 100 * m[0] + '%;transform:translateX(' + shift + '%)'}, m[1]);
      });
      press(colour_buttons, state.channel);
      press(view_buttons, state.overlay ? 1 : 0);
      name1.textContent = state.overlay ? 'predicted' : 'recorded';
      make('small', name1, {}, state.overlay ? 'with the edges of the recorded body' : state.channel === 0 ? 'plain: the error is on the right' : '');
      if (!state.overlay && state.channel === 0 && matchMedia('(max-width:640px)').matches) name1.lastChild.textContent = 'plain: the error is below';
      name2.textContent = 'predicted';
      make('small', name2);
      root.classList.toggle('overlay', state.overlay);
    }
    function show_play() {
      play.innerHTML = state.playing ? '<svg viewBox="0 0 16 16"><path d="M3 2h4v12H3zM9 2h4v12H9z"/></svg>'
        : '<svg viewBox="0 0 16 16"><path d="M4 1.5v13l10-6.5z"/></svg>';
      play.setAttribute('aria-label', state.playing ? 'pause' : 'play');
    }
    var requested = false, before = 0;
    function request() {
      if (requested) return;
      requested = true;
      requestAnimationFrame(tick);
    }
    function tick(now) {
      requested = false;
      if (state.playing) {
        var seconds = Math.min(0.1, (now - before) / 1e3);
        if (state.t >= last) {
          state.hold += seconds;
          if (state.hold > 0.8) { state.t = 0; state.hold = 0; }
        } else {
          state.t = Math.min(last, state.t + seconds * SPEEDS[state.speed][0] / track.h);
        }
      }
      before = now;
      if (gpu && !gl.isContextLost()) render();
      show_numbers();
      if (state.playing) request();
    }
    function seek(t) {
      state.t = Math.min(last, Math.max(0, t));
      state.hold = 0;
      slider.value = state.t;
      request();
    }
    function step(n) {  // along the stored frames
      state.playing = false;
      show_play();
      var at = moment(), k = at.k;
      if (n < 0 && at.part > 0) ++k;
      seek(track.frames[Math.min(track.frames.length - 1, Math.max(0, k + n))]);
    }
    function toggle_play() {
      state.playing = !state.playing;
      if (state.playing && state.t >= last) seek(0);
      before = performance.now();
      show_play();
      request();
    }
    function choose_channel(i) { state.channel = i; show_scale(); request(); }
    function choose_overlay(on) { state.overlay = on; show_scale(); fit(false); request(); }
    function toggle_help() {
      help.hidden = !help.hidden;
      help_button.setAttribute('aria-expanded', help.hidden ? 'false' : 'true');
    }
    function fit(all) {  // the whole motion inside a pane
      var stacked = matchMedia('(max-width:640px)').matches;
      var w = view.clientWidth / (state.overlay || stacked ? 1 : 2), h = view.clientHeight / (stacked && !state.overlay ? 2 : 1);
      var half = Math.atan(Math.tan(FOV / 2) * Math.min(1, w / Math.max(1, h)));
      var wanted = 0.87 * home.radius / Math.sin(half);
      camera.distance = all || !home.distance ? wanted : camera.distance * wanted / home.distance;
      home.distance = wanted;
    }
    function reset() {
      camera.azimuth = -0.9;
      camera.elevation = 0.3;
      camera.target = home.target.slice();
      fit(true);
      request();
    }
    function choose_track(i) {
      state.track = i;
      track = doc.tracks[i];
      last = track.frames[track.frames.length - 1];
      slider.max = last;
      if (chooser) chooser.value = i;
      var middle = track.low.map(function (low, c) { return low + track.size[c] / 2; });
      home = {target: middle, radius: Math.hypot.apply(null, track.size) / 2, distance: 0};
      home.spacing = nice(home.radius / 2);
      grid_label.textContent = doc.ground === null ? '' : 'ground, grid of ' + plain(home.spacing) + ' m';
      if (gpu) load_frames();
      show_scale();
      reset();
      seek(Math.min(state.t, last));
    }

    // 5. Hands.
    var pointers = new Map();
    function turn(dx, dy) {
      camera.azimuth -= 0.008 * dx;
      camera.elevation = Math.min(1.5, Math.max(doc.ground === null ? -1.5 : 0.02, camera.elevation + 0.008 * dy));
      request();
    }
    function move(dx, dy) {
      var a = axes(camera), scale_of = 2 * camera.distance * Math.tan(FOV / 2) / view.clientHeight;
      for (var c = 0; c < 3; ++c) camera.target[c] += scale_of * (dy * a[1][c] - dx * a[0][c]);
      request();
    }
    function zoom(factor) {
      camera.distance = Math.min(20 * home.radius, Math.max(0.3 * home.radius, camera.distance * factor));
      request();
    }
    view.addEventListener('pointerdown', function (event) {
      if (help.contains(event.target)) return;
      view.focus({preventScroll: true});
      view.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    view.addEventListener('pointermove', function (event) {
      var old = pointers.get(event.pointerId);
      if (!old) return;
      var now = [event.clientX, event.clientY], dx = now[0] - old[0], dy = now[1] - old[1];
      if (pointers.size === 2) {  // pinch, and half of the move from each finger
        pointers.forEach(function (other, id) {
          if (id === event.pointerId) return;
          var d0 = Math.hypot(old[0] - other[0], old[1] - other[1]), d1 = Math.hypot(now[0] - other[0], now[1] - other[1]);
          if (d0 > 0 && d1 > 0) zoom(d0 / d1);
        });
        move(dx / 2, dy / 2);
      } else if (event.shiftKey || event.buttons & 6) {
        move(dx, dy);
      } else {
        turn(dx, dy);
      }
      pointers.set(event.pointerId, now);
    });
    ['pointerup', 'pointercancel', 'lostpointercapture'].forEach(function (kind) {
      view.addEventListener(kind, function (event) { pointers.delete(event.pointerId); });
    });
    view.addEventListener('contextmenu', function (event) { event.preventDefault(); });
    view.addEventListener('dblclick', reset);
    view.addEventListener('wheel', function (event) {  // the page scrolls until the player was clicked
      if (document.activeElement !== view && !event.ctrlKey) return;
      event.preventDefault();
      zoom(Math.exp((event.deltaMode ? 16 : 1) * event.deltaY * (event.ctrlKey ? 0.01 : 0.0012)));
    }, {passive: false});
    play.addEventListener('click', toggle_play);
    slider.addEventListener('input', function () { state.t = +slider.value; state.hold = 0; request(); });
    root.addEventListener('keydown', function (event) {
      if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === 'SELECT') return;
      var on_button = event.target.tagName === 'BUTTON' || event.target.type === 'checkbox';
      var jump = event.shiftKey ? 10 : 1;
      switch (event.key) {
        case ' ': if (on_button) return; toggle_play(); break;
        case 'ArrowRight': step(jump); break;
        case 'ArrowLeft': step(-jump); break;
        case 'Home': seek(0); break;
        case 'End': seek(last); break;
        case '1': case '2': case '3': choose_channel(+event.key - 1); break;
        case 'o': choose_overlay(!state.overlay); break;
        case 'e': edge_box.checked = state.edges = !state.edges; request(); break;
        case '+': speed_box.value = state.speed = Math.min(SPEEDS.length - 1, state.speed + 1); break;
        case '-': speed_box.value = state.speed = Math.max(0, state.speed - 1); break;
        case 'r': reset(); break;
        case '?': toggle_help(); break;
        case 'Escape': if (help.hidden) return; toggle_help(); break;
        default: return;
      }
      event.preventDefault();
    });

    // 6. The surroundings change.
    canvas.addEventListener('webglcontextlost', function (event) { event.preventDefault(); gpu = null; });
    canvas.addEventListener('webglcontextrestored', function () { load_gpu(); request(); });
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', function () { read_theme(); request(); });
    new ResizeObserver(function () { fit(false); show_scale(); request(); }).observe(view);

    read_theme();
    show_play();
    choose_track(0);
    load_gpu();
    root.nmpPlayer.seek = seek;
    root.nmpPlayer.render = render;
  }

  document.querySelectorAll('[data-player]').forEach(function (root) {
    try {
      start(root);
    } catch (error) {
      make('p', root, {'class': 'player-message', style: 'position:static'}, 'The player failed: ' + error.message);
      throw error;
    }
  });
})();
