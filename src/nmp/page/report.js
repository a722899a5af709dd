// The read-out of the plots: values of all curves where the pointer is.
(function () {
  'use strict';
  function pretty(v) {
    if (v === null || !isFinite(v)) return '\u2013';
    if (v === 0) return '0';
    var a = Math.abs(v);
    if (a >= 0.01 && a < 1e5) return v.toPrecision(3);
    var parts = v.toExponential(2).split('e'), power = '';
    for (var k = 0; k < parts[1].length; ++k)
      if (parts[1][k] !== '+') power += parts[1][k] === '-' ? '\u207b' : '\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079'[+parts[1][k]];
    return parts[0] + ' \u00d7 10' + power;
  }
  document.querySelectorAll('figure[data-plot]').forEach(function (figure) {
    var data = JSON.parse(figure.querySelector('script').textContent);
    var tip = document.createElement('div');
    tip.className = 'tip';
    tip.hidden = true;
    figure.appendChild(tip);
    figure.querySelectorAll('svg[data-left]').forEach(function (svg) {
      var d = svg.dataset, left = +d.left, right = +d.right, from = +d.from, to = +d.to;
      var cursor = document.createElementNS('http://www.w3.org/2000/svg', 'line');
      cursor.setAttribute('class', 'cursor');
      cursor.setAttribute('y1', d.top);
      cursor.setAttribute('y2', d.bottom);
      cursor.style.display = 'none';
      svg.appendChild(cursor);
      function hide() { tip.hidden = true; cursor.style.display = 'none'; }
      function show(event) {
        var box = svg.getBoundingClientRect(), scale = svg.viewBox.baseVal.width / box.width;
        var at = (event.clientX - box.left) * scale;
        if (at < left - 4 || at > right + 4 || !data.x.length) return hide();
        var x = from + (to - from) * (at - left) / (right - left), best = 0;
        for (var i = 1; i < data.x.length; ++i)
          if (Math.abs(data.x[i] - x) < Math.abs(data.x[best] - x)) best = i;
        at = left + (right - left) * (data.x[best] - from) / ((to - from) || 1);
        cursor.setAttribute('x1', at);
        cursor.setAttribute('x2', at);
        cursor.style.display = '';
        var rows = data.series.map(function (s) { return { s: s, v: s.y[best] }; });
        if (data.sorted) rows.sort(function (a, b) { return (b.v || 0) - (a.v || 0); });
        tip.textContent = '';
        var head = document.createElement('b');
        head.textContent = data.label + ' ' + data.x[best];
        tip.appendChild(head);
        rows.forEach(function (r) {
          var row = document.createElement('div'), name = document.createElement('span');
          var dot = document.createElement('i'), value = document.createElement('span');
          dot.style.background = 'var(--c' + r.s.colour + ')';
          name.appendChild(dot);
          name.appendChild(document.createTextNode(r.s.label));
          value.textContent = pretty(r.v) + (data.unit ? ' ' + data.unit : '');
          row.appendChild(name);
          row.appendChild(value);
          tip.appendChild(row);
        });
        tip.hidden = false;
        var frame = figure.getBoundingClientRect(), x0 = box.left - frame.left + at / scale;
        var space = frame.width - tip.offsetWidth - 8;
        tip.style.left = Math.max(8, x0 + 14 < space ? x0 + 14 : Math.min(space, x0 - tip.offsetWidth - 14)) + 'px';
        tip.style.top = Math.max(4, Math.min(event.clientY - frame.top - 20, frame.height - tip.offsetHeight - 8)) + 'px';
      }
      svg.addEventListener('pointermove', show);
      svg.addEventListener('pointerdown', show);
      svg.addEventListener('pointerleave', hide);
    });
  });
})();
