// What is drawn, with WebGL2. All frames of a motion lie in two buffers; showing a moment means
// pointing the attributes at the two frames around it, which the vertex shader interpolates.

const CHANNELS = ['error', 'det', 'stress', 'speed', 'plain'];

// The colours of the page's theme, 0 ... 1 each.
function theme_of(root) {
  const style = getComputedStyle(root), probe = make('span', root);
  const colour = name => {
    probe.style.color = style.getPropertyValue(name);
    return getComputedStyle(probe).color.match(/[\d.]+/g).slice(0, 3).map(c => c / 255);
  };
  const theme = {shadow: +style.getPropertyValue('--shade-alpha'), own: []};
  for (const name of ['body', 'reference', 'floor', 'pin', 'card', 'ink', 'soft']) theme[name] = colour('--' + name);
  for (let i = 0; i < 8; ++i) theme.own.push(colour('--c' + i));
  probe.remove();
  return theme;
}

function make_scene(canvas) {
  const gl = canvas.getContext('webgl2', {alpha: true, antialias: true, stencil: true, powerPreference: 'high-performance'});
  if (!gl) return null;
  let gpu = null;

  function shader(type, text) {
    const s = gl.createShader(type);
    gl.shaderSource(s, text);
    gl.compileShader(s);
    if (!gl.getShaderParameter(s, gl.COMPILE_STATUS) && !gl.isContextLost()) throw new Error(gl.getShaderInfoLog(s));
    return s;
  }
  function program(vertex, fragment) {
    const p = gl.createProgram();
    gl.attachShader(p, shader(gl.VERTEX_SHADER, vertex));
    gl.attachShader(p, shader(gl.FRAGMENT_SHADER, fragment));
    gl.linkProgram(p);
    if (!gl.getProgramParameter(p, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(gl.getProgramInfoLog(p));
    const at = {};
    for (let i = gl.getProgramParameter(p, gl.ACTIVE_UNIFORMS) - 1; i >= 0; --i) {
      const name = gl.getActiveUniform(p, i).name;
      at[name] = gl.getUniformLocation(p, name);
    }
    return {program: p, at};
  }
  function buffer(target, values) {
    const b = gl.createBuffer();
    gl.bindBuffer(target, b);
    gl.bufferData(target, values, gl.STATIC_DRAW);
    return b;
  }
  function indices(values) { return {buffer: buffer(gl.ELEMENT_ARRAY_BUFFER, values), count: values.length}; }

  function begin() {
    gpu = {body: program(VERTEX, BODY), plain: program(VERTEX, PLAIN), floor: program(FLOOR_VERTEX, FLOOR),
      nothing: gl.createVertexArray(), maps: {}, motions: [], bodies: new Map()};
    for (const name in RAMPS) {
      gpu.maps[name] = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, gpu.maps[name]);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, texels(RAMPS[name]));
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    }
  }
  function load(motions) {  // in place of those before
    for (const old of gpu.motions) { gl.deleteBuffer(old.frames); gl.deleteBuffer(old.normals); }
    gpu.motions = motions.map(motion => {
      if (!gpu.bodies.has(motion.body))
        gpu.bodies.set(motion.body, {triangles: indices(motion.body.triangles),
          edges: indices(motion.body.edges), pinned: indices(motion.body.pinned)});
      return {motion, shape: gpu.bodies.get(motion.body), edge: edge_length(motion),
        frames: buffer(gl.ARRAY_BUFFER, motion.bytes), normals: buffer(gl.ARRAY_BUFFER, motion.normals)};
    });
  }

  // -- one motion at one moment

  function point_at(what, at) {
    const n = what.motion.body.n;
    for (let i = 0; i < 8; ++i) gl.enableVertexAttribArray(i);
    [at.k, at.next].forEach((k, i) => {
      const base = k * frame_bytes(n);
      gl.bindBuffer(gl.ARRAY_BUFFER, what.frames);
      gl.vertexAttribPointer(i, 3, gl.UNSIGNED_SHORT, true, 8, base);
      gl.vertexAttribPointer(2 + i, 2, gl.UNSIGNED_BYTE, true, 8, base + 6);
      gl.vertexAttribPointer(4 + i, 2, gl.UNSIGNED_BYTE, true, 2, base + 8 * n);
      gl.bindBuffer(gl.ARRAY_BUFFER, what.normals);
      gl.vertexAttribPointer(6 + i, 3, gl.BYTE, true, 4, 4 * n * k);
    });
  }
  function use(p, what, at, frame) {
    gl.useProgram(p.program);
    gl.uniformMatrix4fv(p.at.view, false, frame.view);
    gl.uniformMatrix4fv(p.at.projection, false, frame.projection);
    gl.uniform3fv(p.at.low, what.motion.low);
    gl.uniform3fv(p.at.size, what.motion.size);
    gl.uniform1f(p.at.part, at.part);
    gl.uniform1i(p.at.channel, frame.channel);
    gl.uniform1i(p.at.flat_on_floor, 0);
    gl.uniform1f(p.at.bias, 0);
    gl.uniform1f(p.at.floor_z, what.motion.body.ground === null ? 0 : what.motion.body.ground);
  }
  function elements(kind, part) {
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, part.buffer);
    gl.drawElements(kind, part.count, gl.UNSIGNED_INT, 0);
  }
  function draw_plain(what, at, frame, kind, part, colour, alpha, bias) {
    use(gpu.plain, what, at, frame);
    gl.uniform1i(gpu.plain.at.contrast, 0);
    gl.uniform1f(gpu.plain.at.bias, bias);
    gl.uniform1i(gpu.plain.at.round, kind === gl.POINTS ? 1 : 0);
    gl.uniform1f(gpu.plain.at.point_size, frame.point_size);
    gl.uniform4f(gpu.plain.at.plain, ...colour, alpha);
    elements(kind, part);
  }
  function density(what, frame) {  // of its edges: they are paler where they would cover the body
    return Math.min(1, Math.max(0.12, what.edge * frame.pixels_per_metre / 14));
  }
  function draw_edges(which, at, frame) {  // dark on light colours, light on dark ones
    const what = gpu.motions[which];
    paint(gpu.plain, which, at, frame, 0.32 * density(what, frame));
    gl.uniform1i(gpu.plain.at.contrast, 1);
    gl.uniform1i(gpu.plain.at.round, 0);
    gl.uniform1f(gpu.plain.at.bias, 2e-4);
    elements(gl.LINES, what.shape.edges);
  }
  function draw_net(which, at, frame) {
    const what = gpu.motions[which], colour = which ? frame.theme.own[which % 8] : frame.theme.reference;
    draw_plain(what, at, frame, gl.LINES, what.shape.edges, colour, 0.8 * Math.sqrt(density(what, frame)), 3e-4);
  }
  function draw_shadow(what, at, frame) {  // each pixel once
    gl.enable(gl.STENCIL_TEST);
    gl.stencilFunc(gl.EQUAL, 0, 255);
    gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
    gl.depthMask(false);
    use(gpu.plain, what, at, frame);
    gl.uniform1i(gpu.plain.at.contrast, 0);
    gl.uniform1i(gpu.plain.at.flat_on_floor, 1);
    gl.uniform1i(gpu.plain.at.round, 0);
    gl.uniform4f(gpu.plain.at.plain, 0, 0, 0, frame.theme.shadow);
    elements(gl.TRIANGLES, what.shape.triangles);
    gl.depthMask(true);
    gl.disable(gl.STENCIL_TEST);
  }
  function draw_floor(body, frame) {
    const p = gpu.floor, home = frame.home;
    gl.useProgram(p.program);
    gl.uniformMatrix4fv(p.at.view, false, frame.view);
    gl.uniformMatrix4fv(p.at.projection, false, frame.projection);
    gl.uniform3f(p.at.centre, home.target[0], home.target[1], body.ground);
    gl.uniform1f(p.at.extent, 3.2 * home.radius);
    gl.uniform1f(p.at.spacing, home.spacing);
    gl.uniform4f(p.at.plain, ...frame.theme.floor, 1);
    gl.bindVertexArray(gpu.nothing);
    gl.depthMask(false);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    gl.depthMask(true);
    gl.bindVertexArray(null);
  }
  function paint(p, which, at, frame, alpha) {  // with the colours of the channel
    const what = gpu.motions[which], name = CHANNELS[frame.channel], own = frame.theme.own[which % 8];
    const coloured = name === 'error' ? what.motion.rmse[at.near] !== null && !at.ended
      : name === 'stress' ? what.motion.body.stress : name !== 'plain';
    use(p, what, at, frame);
    gl.uniform1i(p.at.coloured, coloured ? 1 : 0);
    gl.uniform4f(p.at.plain, ...frame.theme.body.map((c, i) => name === 'plain' && which ? 0.35 * c + 0.65 * own[i] : c), alpha);
    gl.bindTexture(gl.TEXTURE_2D, gpu.maps[coloured ? name : 'det']);
  }
  function draw_body(which, at, frame) {
    paint(gpu.body, which, at, frame, 1);
    elements(gl.TRIANGLES, gpu.motions[which].shape.triangles);
  }

  // -- a picture

  // frame: camera, theme, home, ratio, channel, edges, at (a moment per motion), and
  // panes [{x, y, w, h (part of the canvas, from its top), solid, nets}] of numbers of motions.
  function draw(frame) {
    const {width, height} = canvas, {camera, home} = frame;
    Object.assign(frame, {view: look(camera)});
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    for (const pane of frame.panes) {
      const w = Math.round(pane.w * width), h = Math.round(pane.h * height);
      gl.viewport(Math.round(pane.x * width), height - Math.round(pane.y * height) - h, w, h);
      frame.projection = perspective(w / h, 0.02 * camera.distance, camera.distance + 8 * home.radius);
      frame.point_size = frame.ratio * Math.max(4, Math.min(9, Math.min(w, h) / frame.ratio / 40));
      frame.pixels_per_metre = h / frame.ratio / (2 * camera.distance * Math.tan(FOV / 2));
      const what = gpu.motions[pane.solid], body = what.motion.body, at = frame.at[pane.solid];
      if (body.ground !== null) draw_floor(body, frame);
      point_at(what, at);
      if (body.ground !== null) draw_shadow(what, at, frame);
      draw_body(pane.solid, at, frame);
      if (frame.edges) draw_edges(pane.solid, at, frame);
      if (what.shape.pinned.count) draw_plain(what, at, frame, gl.POINTS, what.shape.pinned, frame.theme.pin, 1, 6e-4);
      for (const i of pane.nets) {
        point_at(gpu.motions[i], frame.at[i]);
        draw_net(i, frame.at[i], frame);
      }
    }
  }

  return {gl, begin, load, draw, ready: () => gpu !== null && !gl.isContextLost(), forget: () => { gpu = null; }};
}
