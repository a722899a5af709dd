// Pointer, wheel and keys.

// act: {turn(dx, dy), move(dx, dy), zoom(factor), reset()} in pixels.
function listen_to_pointer(view, except, act) {
  const pointers = new Map();
  view.addEventListener('pointerdown', event => {
    if (except.some(element => element.contains(event.target))) return;
    view.focus({preventScroll: true});
    view.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  view.addEventListener('pointermove', event => {
    const old = pointers.get(event.pointerId);
    if (!old) return;
    const now = [event.clientX, event.clientY], dx = now[0] - old[0], dy = now[1] - old[1];
    if (pointers.size === 2) {  // pinch, and half of the move from each finger
      pointers.forEach((other, id) => {
        if (id === event.pointerId) return;
        const before = Math.hypot(old[0] - other[0], old[1] - other[1]);
        const after = Math.hypot(now[0] - other[0], now[1] - other[1]);
        if (before > 0 && after > 0) act.zoom(before / after);
      });
      act.move(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons & 6) {
      act.move(dx, dy);
    } else {
      act.turn(dx, dy);
    }
    pointers.set(event.pointerId, now);
  });
  for (const kind of ['pointerup', 'pointercancel', 'lostpointercapture'])
    view.addEventListener(kind, event => pointers.delete(event.pointerId));
  view.addEventListener('contextmenu', event => event.preventDefault());
  view.addEventListener('dblclick', event => { if (!except.some(e => e.contains(event.target))) act.reset(); });
  view.addEventListener('wheel', event => {  // the page scrolls until the player was clicked
    if (document.activeElement !== view && !event.ctrlKey) return;
    event.preventDefault();
    act.zoom(Math.exp((event.deltaMode ? 16 : 1) * event.deltaY * (event.ctrlKey ? 0.01 : 0.0012)));
  }, {passive: false});
}

// What the help says: [keys, what they do].
const KEYS = [['Space', 'play, pause'], ['\u2190 \u2192', 'one stored frame; with Shift ten'],
  ['Home End', 'first, last frame'], ['1 \u2026 5', 'colour: error, det F, stress, speed, plain'],
  ['o', 'overlay: one over the other'], ['n', 'in the overlay: the next one'], ['e', 'edges; in the overlay, those of the solid one'], ['l', 'loop'],
  ['+ \u2212', 'faster, slower'], ['r', 'reset the view'], ['s', 'save a picture'], ['?', 'these keys']];

// act: a function for each key, given the event; one that returns false leaves the key alone.
function listen_to_keys(root, act) {
  root.addEventListener('keydown', event => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === 'SELECT') return;
    if (!act[event.key] || act[event.key](event) === false) return;
    event.preventDefault();
  });
}

function make_help(view) {
  const help = make('div', view, {'class': 'player-help', hidden: ''}), list = make('dl', help);
  for (const [keys, what] of KEYS) {
    const dt = make('dt', list);
    keys.split(' ').forEach((key, i) => {
      if (i) dt.appendChild(document.createTextNode(' '));
      if (key === '\u2026') dt.appendChild(document.createTextNode(key)); else make('kbd', dt, {}, key);
    });
    make('dd', list, {}, what);
  }
  make('div', help, {}, 'Drag: turn. Shift and drag, or two fingers: move. Wheel, once clicked, or pinch: zoom.');
  return help;
}
