// The 3D player: motions beside each other, on one clock and seen by one camera. What it reads is
// described in player_data.h; the files player_*.js are its parts, joined with it into one script.

const SPEEDS = [[1 / 64, '1/64 \u00d7'], [1 / 16, '1/16 \u00d7'], [1 / 8, '1/8 \u00d7'], [1 / 4, '1/4 \u00d7'],
  [1 / 2, '1/2 \u00d7'], [1, 'real time'], [2, '2 \u00d7'], [4, '4 \u00d7']];
const NAMES = ['error', 'det F', 'stress', 'speed', 'plain'];
const PAUSE = '<svg viewBox="0 0 16 16"><path d="M3 2h4v12H3zM9 2h4v12H9z"/></svg>';
const PLAY = '<svg viewBox="0 0 16 16"><path d="M4 1.5v13l10-6.5z"/></svg>';

function start(root) {
  const source = root.querySelector('script'), doc = JSON.parse(source.textContent);
  source.remove();
  const still = matchMedia('(prefers-reduced-motion: reduce)').matches;
  const state = {track: 0, t: 0, playing: false, speed: 3, channel: 0, overlay: false, chosen: 0,
    edges: true, edges_over: false, loop: !still, hold: 0};  // edges_over: in the overlay, besides the nets
  const camera = {azimuth: 0, elevation: 0, distance: 1, target: [0, 0, 0]};
  const stats = {draws: 0, script_ms: 0, load_ms: 0};
  const bodies = doc.bodies.map(read_body);
  let motions = [], clock = [0], end = 0, home = null, theme = null, labels = [], head = 0, before = 0, requested = false;

  // 1. Elements.
  const view = make('div', root, {'class': 'player-view', tabindex: '0', role: 'application',
    'aria-label': '3D player of motions. Space plays, arrow keys step, question mark lists the keys.'});
  const canvas = make('canvas', view, {'aria-hidden': 'true'});
  const panes = make('div', view, {'class': 'player-panes'});
  const message = make('p', view, {'class': 'player-message', role: 'status', hidden: ''});
  const help = make_help(view);

  const time = make('div', root, {'class': 'player-time'});
  const play = make('button', time, {type: 'button', 'class': 'play', 'aria-label': 'play'});
  const slider = make('input', time, {type: 'range', min: '0', value: '0', step: 'any', 'aria-label': 'time'});
  const numbers = make('div', root, {'class': 'player-numbers'});
  const number = kind => {
    const box = make('div', numbers, {'class': kind}), value = make('b', box);
    make('span', box, {}, kind);
    return value;
  };
  const frame_value = number('frame'), time_value = number('time'), grid_value = number('ground grid');
  const pins = make('div', numbers, {'class': 'pin'}, 'pinned vertices');
  const scale = make('div', numbers, {'class': 'player-scale'});
  const scale_title = make('span', scale), ramp = make('div', scale, {'class': 'gradient'}), ticks = make('div', scale, {'class': 'ticks'});

  const settings = make('div', root, {'class': 'player-settings'});
  const chooser = doc.tracks.length < 2 ? null
    : choice(settings, 'trajectory', doc.tracks.map(t => t.name.replace(/\.safetensors$/, '')), choose_track);
  const colour_buttons = segments(settings, 'colour', NAMES, choose_channel);
  const view_buttons = segments(settings, 'view', ['side by side', 'overlay'], i => choose_overlay(i === 1));
  const edge_box = checkbox(settings, 'edges', state.edges, choose_edges);
  const loop_box = checkbox(settings, 'loop', state.loop, on => { state.loop = on; });
  const speed_box = choice(settings, 'play at', SPEEDS.map(s => s[1]), i => { state.speed = i; });
  const ends = make('span', settings, {'class': 'end'});
  const button = (text, act, properties) => {
    const b = make('button', ends, Object.assign({type: 'button'}, properties), text);
    b.addEventListener('click', act);
    return b;
  };
  button('save PNG', save_picture, {title: 's: a picture of what is shown'});
  button('reset view', reset, {title: 'r'});
  const help_button = button('?', toggle_help, {'aria-label': 'keys', 'aria-expanded': 'false'});

  const scene = make_scene(canvas);
  root.nmpPlayer = {state, stats, camera, document: doc, webgl: !!scene, seek, render, picture, choose_track};
  if (!scene) {
    message.textContent = 'This browser offers no WebGL2, which the player needs. Everything else on this page works without it.';
    message.hidden = false;
    for (const element of [time, numbers, settings, panes, canvas]) element.hidden = true;
    view.classList.add('empty');
    return;
  }

  // 2. What can be shown of this track.
  function available(channel) {
    const name = CHANNELS[channel];
    return name === 'error' ? motions.some(m => m.compared) : name !== 'stress' || motions.some(m => m.body.stress);
  }
  function several() { return motions.length > 1; }
  // The panes as parts of the view; motions that are drawn solid and as nets of edges.
  function layout() {
    const all = motions.map((_, i) => i);
    if (state.overlay) return [{x: 0, y: head, w: 1, h: 1 - head, solid: state.chosen, nets: state.chosen ? [0] : all.slice(1)}];
    const columns = columns_of(all.length, view.clientWidth, view.clientHeight), rows = Math.ceil(all.length / columns);
    return all.map(i => ({x: i % columns / columns, y: Math.floor(i / columns) / rows, w: 1 / columns, h: 1 / rows, solid: i, nets: []}));
  }
  function show_panes() {  // boxes with the motions' names
    panes.textContent = '';
    labels = [];
    head = 0;
    if (state.overlay) show_choice();
    for (const pane of layout()) {
      const box = make('div', panes, {'class': 'player-pane', style:
        `left:${100 * pane.x}%;top:${100 * pane.y}%;width:${100 * pane.w}%;height:${100 * pane.h}%`});
      if (pane.x + pane.w < 0.999) box.classList.add('beside');
      if (pane.y + pane.h < 0.999) box.classList.add('above');
      if (!state.overlay) show_name(box, 'div', pane.solid, several() ? 'solid' : '');
    }
  }
  function show_name(box, tag, i, drawn) {
    const name = make(tag, box, {'class': 'player-name'});
    if (drawn) make('i', name, {'class': drawn, style: `--own:var(--${i ? 'c' + i % 8 : 'reference'})`});
    make('span', name, {}, motions[i].label);
    if (state.overlay) { make('br', name); make('em', name, {}, drawn); }
    labels[i] = make('small', name);
    return name;
  }
  function show_choice() {  // the names in the overlay: which one is solid, which ones are nets
    const box = make('div', panes, {'class': 'player-choice'}), [{solid, nets}] = layout();
    motions.forEach((_, i) => {
      const name = show_name(box, 'button', i, i === solid ? 'solid' : nets.includes(i) ? 'net' : 'hidden');
      name.type = 'button';
      name.setAttribute('aria-pressed', i === solid ? 'true' : 'false');
      name.addEventListener('click', () => choose(i));
    });
    // On a phone they would cover the body, which is drawn below them there.
    if (matchMedia('(max-width:640px)').matches) head = Math.min(0.5, (box.offsetTop + box.offsetHeight) / view.clientHeight);
  }
  function note_of(i, at) {  // what is said below a motion's name
    const m = motions[i];
    if (at.ended)
      return `${m.diverged ? 'diverged' : 'ended'} after frame ${m.frames[m.frames.length - 1]}, held since`;
    const rmse = m.rmse[at.near], kind = CHANNELS[state.channel];
    if (rmse !== null) return 'RMSE ' + metres(rmse);
    if (i === 0 && motions.some(other => other.compared)) return 'reference x*';
    if (kind === 'error' && several()) return 'nothing to compare with';
    return kind === 'stress' && !m.body.stress ? 'its law is not known' : '';
  }
  function show_numbers() {
    const moments = motions.map(m => moment(m, state.t)), first = motions[0];
    const last = first.frames[first.frames.length - 1], frame = Math.min(last, Math.round(state.t / first.h));
    const show = (element, text) => { if (element.textContent !== text) element.textContent = text; };
    show(frame_value, frame + ' / ' + last);
    show(time_value, seconds(state.t, end));
    motions.forEach((_, i) => show(labels[i], note_of(i, moments[i])));
    if (document.activeElement !== slider || state.playing) slider.value = state.t;
    slider.setAttribute('aria-valuetext', `frame ${frame} of ${last}, ${seconds(state.t, end)}`);
  }
  // The title, the ramp and [part, text] of the ticks of the scale; null if there is none.
  function legend() {
    const name = CHANNELS[state.channel], s = doc.scales[name], marks = [];
    if (!s) return null;
    const unit = name === 'stress' ? pascals(s.high) : ['', 1];
    const title = {error: 'error |x \u2212 x*| [m]', det: 'det F [\u2013]', stress: `von Mises stress [${unit[0]}]`, speed: 'speed [m/s]'}[name];
    if (s.log) {
      const from = Math.log10(s.low), to = Math.log10(s.high);
      for (let d = Math.ceil(from - 1e-6); d <= to + 1e-6; ++d) marks.push([(d - from) / (to - from), power(d)]);
    } else {
      for (let i = 0; i <= 4; ++i) marks.push([i / 4, short((s.low + (s.high - s.low) * i / 4) / unit[1])]);
      marks[4][1] = '\u2265 ' + marks[4][1];
    }
    if (name === 'det') marks[0][1] = '\u2264 ' + marks[0][1];
    return {title, ramp: RAMPS[name], ticks: marks};
  }
  function show_scale() {
    const what = legend();
    scale.style.visibility = what ? '' : 'hidden';
    if (what) {
      scale_title.textContent = what.title;
      ramp.style.background = 'linear-gradient(90deg,' + what.ramp.join(',') + ')';
      ticks.textContent = '';
      for (const [part, text] of what.ticks) {  // those at the ends stay inside
        const shift = part < 0.04 ? 0 : part > 0.96 ? -100 : -50;
        make('span', ticks, {style: `left:${100 * part}%;transform:translateX(${shift}%)`}, text);
      }
    }
    press(colour_buttons, state.channel);
    press(view_buttons, state.overlay ? 1 : 0);
    edge_box.checked = edges_shown();
  }
  function show_place() {
    grid_value.textContent = short(home.spacing) + ' m';
    grid_value.parentNode.hidden = motions.every(m => m.body.ground === null);
    pins.hidden = motions.every(m => m.body.pinned.length === 0);
  }
  function show_about() {  // under the title of a page that is a player
    const line = document.querySelector('[data-about]'), law = motions[0].body.law;
    const name = doc.tracks[state.track].name.replace(/\.safetensors$/, '');
    if (line) line.textContent = [name, short(end) + ' s', law && 'stresses: ' + law].filter(Boolean).join(' \u00b7 ');
  }
  function show_play() {
    play.innerHTML = state.playing ? PAUSE : PLAY;
    play.setAttribute('aria-label', state.playing ? 'pause' : 'play');
  }

  // 3. Drawing.
  function render() {
    const begin = performance.now(), ratio = Math.min(2, window.devicePixelRatio || 1);
    const width = Math.round(view.clientWidth * ratio), height = Math.round(view.clientHeight * ratio);
    if (!width || !height || !scene.ready()) return;
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    scene.draw({camera, theme, home, ratio, channel: state.channel, edges: edges_shown(),
      at: motions.map(m => moment(m, state.t)), panes: layout()});
    ++stats.draws;
    stats.script_ms += performance.now() - begin;
  }
  function picture() {
    render();
    const at = motions.map(m => moment(m, state.t));
    return compose_picture(canvas, {theme, ratio: Math.min(2, window.devicePixelRatio || 1), scale: legend(),
      time: 't = ' + seconds(state.t, end), panes: layout().map(pane => Object.assign(pane,
        {title: motions[pane.solid].label, note: [note_of(pane.solid, at[pane.solid])].concat(
          pane.nets.map(i => 'net: ' + motions[i].label)).filter(Boolean).join('; ')}))});
  }
  function save_picture() {
    picture().toBlob(blob => {
      const link = make('a', null), url = URL.createObjectURL(blob);
      link.href = url;
      link.download = `nmp-${NAMES[state.channel].replace(' ', '')}-${(1e3 * state.t).toFixed(1)}ms.png`;
      link.click();
      setTimeout(() => URL.revokeObjectURL(url), 10000);
    });
  }
  function request() {
    if (requested) return;
    requested = true;
    requestAnimationFrame(tick);
  }
  function tick(now) {
    requested = false;
    if (state.playing) advance(Math.min(0.1, (now - before) / 1e3));
    before = now;
    render();
    show_numbers();
    if (state.playing) request();
  }
  function advance(passed) {
    if (state.t < end) {
      state.t = Math.min(end, state.t + passed * SPEEDS[state.speed][0]);
      return;
    }
    state.hold += passed;
    if (!state.loop) { state.playing = false; show_play(); }
    if (state.loop && state.hold > 0.8) { state.t = 0; state.hold = 0; }
  }

  // 4. What one can ask for.
  function seek(t) {
    state.t = Math.min(end, Math.max(0, t));
    state.hold = 0;
    slider.value = state.t;
    request();
  }
  function step(n) {  // along the stored frames of all motions
    state.playing = false;
    show_play();
    const same = 1e-6 * motions[0].h;
    let k = clock.findIndex(t => t > state.t + same);
    k = (k < 0 ? clock.length : k) - 1;  // the last that is not after now
    if (n < 0 && clock[k] < state.t - same) ++k;
    seek(clock[Math.min(clock.length - 1, Math.max(0, k + n))]);
  }
  function toggle_play() {
    state.playing = !state.playing;
    if (state.playing && state.t >= end) seek(0);
    before = performance.now();
    show_play();
    request();
  }
  function choose_channel(i) {
    if (!available(i)) return;
    state.channel = i;
    show_scale();
    request();
  }
  function choose_overlay(on) {
    state.overlay = on && several();
    rearrange();
  }
  function choose(i) { state.chosen = i; rearrange(); }
  function edges_shown() { return state.overlay ? state.edges_over : state.edges; }
  function choose_edges(on) {
    state[state.overlay ? 'edges_over' : 'edges'] = edge_box.checked = on;
    request();
  }
  function choose_speed(i) { speed_box.value = state.speed = Math.min(SPEEDS.length - 1, Math.max(0, i)); }
  function rearrange() { show_panes(); show_numbers(); show_scale(); fit(false); request(); }
  function toggle_help() {
    help.hidden = !help.hidden;
    help_button.setAttribute('aria-expanded', help.hidden ? 'false' : 'true');
  }
  function fit(all) {  // the whole motion inside a pane
    const pane = layout()[0], w = view.clientWidth * pane.w, h = view.clientHeight * pane.h;
    const half = Math.atan(Math.tan(FOV / 2) * Math.min(1, w / Math.max(1, h)));
    const wanted = 0.87 * home.radius / Math.sin(half);
    camera.distance = all || !home.distance ? wanted : camera.distance * wanted / home.distance;
    home.distance = wanted;
  }
  function reset() {
    Object.assign(camera, {azimuth: -0.9, elevation: 0.3, target: home.target.slice()});
    fit(true);
    request();
  }
  function choose_track(i) {
    const begin = performance.now();
    state.track = i;
    motions = doc.tracks[i].motions.map(m => read_motion(m, bodies[m.body]));
    clock = clock_of(motions);
    end = slider.max = clock[clock.length - 1];
    state.t = Math.min(state.t, end);
    home = home_of(motions);
    if (scene.ready()) scene.load(motions);
    stats.load_ms = performance.now() - begin;
    if (chooser) chooser.value = i;
    state.chosen = motions.length - 1;
    state.overlay = state.overlay && several();
    if (!available(state.channel)) state.channel = CHANNELS.indexOf('speed');
    colour_buttons.forEach((b, k) => { b.disabled = !available(k); });
    view_buttons[0].parentNode.hidden = !several();
    show_place();
    show_about();
    rearrange();
    reset();
    seek(state.t);
  }
  // #time=0.05&colour=stress&view=overlay&track=1&motion=2&edges=0, for links and pictures from a script.
  function obey_address() {
    const wish = new URLSearchParams(location.hash.slice(1));
    if (doc.tracks[+wish.get('track')] && +wish.get('track') !== state.track) choose_track(+wish.get('track'));
    const channel = CHANNELS.indexOf(wish.get('colour'));
    if (channel >= 0) choose_channel(channel);
    if (wish.has('view')) choose_overlay(wish.get('view') === 'overlay');
    if (wish.has('motion') && motions[+wish.get('motion')]) choose(+wish.get('motion'));
    if (wish.has('edges')) {
      state.edges = state.edges_over = wish.get('edges') !== '0';
      choose_edges(state.edges);
    }
    if (wish.has('time')) seek(+wish.get('time') || 0);
    request();
  }

  // 5. Hands.
  listen_to_pointer(view, [help, panes], {
    turn(dx, dy) {
      const lowest = motions.some(m => m.body.ground !== null) ? 0.02 : -1.5;
      camera.azimuth -= 0.008 * dx;
      camera.elevation = Math.min(1.5, Math.max(lowest, camera.elevation + 0.008 * dy));
      request();
    },
    move(dx, dy) {
      const a = axes(camera), metre = 2 * camera.distance * Math.tan(FOV / 2) / (view.clientHeight * layout()[0].h);
      for (let c = 0; c < 3; ++c) camera.target[c] += metre * (dy * a[1][c] - dx * a[0][c]);
      request();
    },
    zoom(factor) {
      camera.distance = Math.min(20 * home.radius, Math.max(0.1 * home.radius, camera.distance * factor));
      request();
    },
    reset
  });
  const on_control = event => event.target.tagName === 'BUTTON' || event.target.type === 'checkbox';
  const keys = {
    ' ': event => on_control(event) ? false : toggle_play(),
    ArrowRight: event => step(event.shiftKey ? 10 : 1), ArrowLeft: event => step(event.shiftKey ? -10 : -1),
    Home: () => seek(0), End: () => seek(end),
    o: () => choose_overlay(!state.overlay), n: () => choose((state.chosen + 1) % motions.length),
    e: () => choose_edges(!edges_shown()),
    l: () => { loop_box.checked = state.loop = !state.loop; },
    '+': () => choose_speed(state.speed + 1), '-': () => choose_speed(state.speed - 1),
    r: reset, s: save_picture, '?': toggle_help, Escape: () => help.hidden ? false : toggle_help()
  };
  CHANNELS.forEach((_, i) => { keys[i + 1] = () => choose_channel(i); });
  listen_to_keys(root, keys);
  play.addEventListener('click', toggle_play);
  slider.addEventListener('input', () => { state.t = +slider.value; state.hold = 0; request(); });

  // 6. The surroundings change.
  function begin_drawing() { scene.begin(); scene.load(motions); request(); }
  canvas.addEventListener('webglcontextlost', event => { event.preventDefault(); scene.forget(); });
  canvas.addEventListener('webglcontextrestored', begin_drawing);
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => { theme = theme_of(root); request(); });
  new ResizeObserver(() => { rearrange(); render(); }).observe(view);  // drawn before it is stretched
  window.addEventListener('hashchange', obey_address);

  theme = theme_of(root);
  choose_speed(state.speed);
  show_play();
  choose_track(0);
  begin_drawing();
  obey_address();
}

document.querySelectorAll('[data-player]').forEach(root => {
  try {
    start(root);
  } catch (error) {
    make('p', root, {'class': 'player-message', style: 'position:static'}, 'The player failed: ' + error.message);
    throw error;
  }
});
