// A picture of what is shown, with its names, time and scale, as a canvas.

function css(colour) { return 'rgb(' + colour.map(c => Math.round(255 * c)).join(',') + ')'; }

// source: the player's canvas, just drawn.  what: {theme, ratio, panes [{x, y, w, h, title, note}],
// time, scale {title, ramp, ticks [[part, text]]} or null}
function compose_picture(source, what) {
  const picture = document.createElement('canvas'), ratio = what.ratio, foot = 54 * ratio;
  picture.width = source.width;
  picture.height = source.height + foot;
  const c = picture.getContext('2d'), {theme} = what;
  const say = (text, x, y, size, colour, weight, align) => {
    c.font = (weight || 400) + ' ' + size * ratio + 'px system-ui, sans-serif';
    c.textAlign = align || 'left';
    c.fillStyle = css(colour);
    c.fillText(text, x, y);
  };
  c.fillStyle = css(theme.card);
  c.fillRect(0, 0, picture.width, picture.height);
  c.drawImage(source, 0, 0);
  for (const pane of what.panes) {
    const x = pane.x * source.width, y = pane.y * source.height;
    c.strokeStyle = css(theme.soft.map((v, i) => 0.3 * v + 0.7 * theme.card[i]));
    c.lineWidth = ratio;
    c.strokeRect(x, y, pane.w * source.width, pane.h * source.height);
    say(pane.title, x + 12 * ratio, y + 22 * ratio, 14, theme.ink, 600);
    say(pane.note, x + 12 * ratio, y + 40 * ratio, 12.5, theme.soft);
  }
  const top = source.height;
  say(what.time, 12 * ratio, top + 33 * ratio, 15, theme.ink, 600);
  if (!what.scale) return picture;
  const width = Math.min(320 * ratio, picture.width / 2 - 24 * ratio), left = picture.width - width - 16 * ratio;
  const ramp = c.createLinearGradient(left, 0, left + width, 0);
  what.scale.ramp.forEach((colour, i, all) => ramp.addColorStop(i / (all.length - 1), colour));
  say(what.scale.title, left, top + 17 * ratio, 12.5, theme.soft);
  c.fillStyle = ramp;
  c.fillRect(left, top + 22 * ratio, width, 10 * ratio);
  for (const [part, text] of what.scale.ticks)
    say(text, left + part * width, top + 47 * ratio, 12, theme.soft, 400, part < 0.04 ? 'left' : part > 0.96 ? 'right' : 'center');
  return picture;
}
