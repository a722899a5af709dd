#pragma once

/// Style and script of a report's page (report.cpp). Colours --c0 ... --c7 are after Okabe and
/// Ito's palette, told apart with any colour vision; curves differ by their dashes as well.
namespace nmp {

constexpr const char* kReportStyle = R"css(
:root { color-scheme: light dark;
  --bg:#fbfbf9; --card:#fff; --ink:#1b1f24; --soft:#5c6570; --line:#e3e4e0; --grid:#ecede9; --hi:#eaf3fa;
  --c0:#0072b2; --c1:#d55e00; --c2:#00805c; --c3:#b0568b; --c4:#a87400; --c5:#3a8fc4; --c6:#59616b; --c7:#8a9099; }
@media (prefers-color-scheme: dark) { :root {
  --bg:#14171a; --card:#1b1f23; --ink:#e7e9ea; --soft:#9aa3ac; --line:#30363c; --grid:#262b30; --hi:#17303f;
  --c0:#4db2ff; --c1:#ff8f45; --c2:#35d0a5; --c3:#e59ac4; --c4:#f2bb4a; --c5:#93cdf0; --c6:#aab2ba; --c7:#7d868f; } }
* { box-sizing:border-box; }
body { margin:0; background:var(--bg); color:var(--ink);
  font:16px/1.55 system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",sans-serif; }
main { max-width:1020px; margin:0 auto; padding:40px 24px 64px; }
h1 { font-size:30px; line-height:1.2; margin:0 0 10px; letter-spacing:-.01em; }
h2 { font-size:21px; margin:52px 0 6px; letter-spacing:-.005em; }
header + section h2 { margin-top:30px; }
h3 { font-size:16px; margin:34px 0 4px; }
p { margin:6px 0 12px; max-width:70ch; }
.eyebrow { color:var(--soft); font-size:13px; letter-spacing:.06em; text-transform:uppercase; margin:0 0 6px; }
.lead { font-size:19px; line-height:1.5; }
.note { color:var(--soft); font-size:14px; }
.tiles { display:grid; grid-template-columns:repeat(auto-fit,minmax(150px,1fr)); gap:12px; margin:22px 0 18px; padding:0; }
.tile { background:var(--card); border:1px solid var(--line); border-radius:10px; padding:13px 16px; }
.tile b { display:block; font-size:23px; font-weight:650; line-height:1.3; font-variant-numeric:tabular-nums; white-space:nowrap; }
.tile span { color:var(--soft); font-size:13.5px; line-height:1.35; display:block; }
ul.findings { margin:14px 0 22px; padding:0; list-style:none; max-width:74ch; }
ul.findings li { padding:3px 0 3px 16px; border-left:3px solid var(--line); margin:9px 0; }
ul.findings li.plain { border-color:var(--c4); }
.scroll { overflow-x:auto; margin:12px 0; border:1px solid var(--line); border-radius:10px; background:var(--card); }
table { border-collapse:collapse; width:100%; font-size:14.5px; font-variant-numeric:tabular-nums; }
th,td { text-align:right; padding:9px 13px; white-space:nowrap; vertical-align:top; }
th:first-child,td:first-child { text-align:left; position:sticky; left:0; background:var(--card); }
thead th { font-weight:600; border-bottom:1px solid var(--line); }
thead th small,td small { display:block; color:var(--soft); font-weight:400; font-size:12.5px; line-height:1.4; }
tbody tr+tr td { border-top:1px solid var(--grid); }
tr.us td, tr.us td:first-child { background:var(--hi); }
tr.us td { font-weight:650; } tr.us td small { font-weight:400; }
tr.paper td { border-top:1px solid var(--line) !important; color:var(--soft); }
td.bad { color:var(--c1); font-weight:650; }
.key { display:inline-block; width:26px; height:8px; margin-right:8px; vertical-align:middle; overflow:visible; }
figure { position:relative; margin:10px 0 6px; background:var(--card); border:1px solid var(--line); border-radius:10px; padding:14px 14px 8px; }
figure svg { display:block; width:100%; height:auto; }
figure .narrow { display:none; }
figure text { font-size:12.5px; fill:var(--soft); }
figure text.title { font-size:12.5px; }
.grid { stroke:var(--grid); } .axis { stroke:var(--soft); stroke-opacity:.6; } .rule { stroke:var(--grid); }
.mark { stroke:var(--soft); stroke-opacity:.45; stroke-dasharray:1 4; stroke-linecap:round; stroke-width:1.5; }
.leader { stroke-opacity:.55; } .band { opacity:.16; } .background { fill:var(--soft); opacity:.13; }
.legend { display:flex; flex-wrap:wrap; gap:4px 18px; margin:10px 0 2px; padding:0; list-style:none; font-size:13.5px; color:var(--soft); }
.stages { display:grid; grid-template-columns:repeat(auto-fit,minmax(270px,1fr)); gap:12px; }
.stages figure { margin:0; } .stages figcaption { font-weight:600; font-size:14.5px; margin-bottom:6px; }
.stages figcaption small { display:block; font-weight:400; color:var(--soft); font-size:12.5px; }
details { border:1px solid var(--line); border-radius:10px; background:var(--card); margin:10px 0; }
summary { cursor:pointer; padding:11px 16px; font-weight:600; }
pre { margin:0; padding:4px 16px 14px; overflow-x:auto; font:13px/1.5 ui-monospace,SFMono-Regular,Menlo,Consolas,monospace; }
.tip { position:absolute; pointer-events:none; background:var(--card); color:var(--ink); border:1px solid var(--line);
  border-radius:8px; padding:8px 11px; font-size:12.5px; line-height:1.5; box-shadow:0 4px 16px rgb(0 0 0/.14); z-index:2;
  font-variant-numeric:tabular-nums; white-space:nowrap; }
.tip b { display:block; } .tip i { display:inline-block; width:9px; height:9px; border-radius:50%; margin-right:7px; }
.tip div { display:flex; justify-content:space-between; gap:18px; }
.cursor { stroke:var(--soft); stroke-opacity:.7; pointer-events:none; }
footer { margin-top:56px; color:var(--soft); font-size:13.5px; }
@media (max-width:640px) {
  main { padding:24px 14px 48px; } h1 { font-size:25px; } .lead { font-size:17px; }
  figure { padding:10px 8px 6px; } figure .wide { display:none; } figure .narrow { display:block; }
  th,td { padding:8px 10px; } th:first-child,td:first-child { white-space:normal; min-width:132px; max-width:150px; } }
@media print { details:not([open])>*:not(summary) { display:block; } .tiles,figure,.scroll { break-inside:avoid; } }
)css";

constexpr const char* kReportScript = R"js(
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
)js";

}  // namespace nmp
