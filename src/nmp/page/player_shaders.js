// GLSL of the player. Attributes come in pairs, of the two stored frames around the moment that is
// shown; `part` of the way lies between them.
const VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec3 x0; layout(location = 1) in vec3 x1;  // in the box, 0 ... 1
layout(location = 2) in vec2 q0; layout(location = 3) in vec2 q1;  // det F, speed
layout(location = 4) in vec2 e0; layout(location = 5) in vec2 e1;  // error, stress
layout(location = 6) in vec3 n0; layout(location = 7) in vec3 n1;  // normal
uniform vec3 low, size;
uniform mat4 view, projection;
uniform float part, floor_z, bias, point_size;
uniform int channel;
uniform bool flat_on_floor;
out vec3 eye, normal;
out float value;
void main() {
  vec3 x = low + size * mix(x0, x1, part);
  if (flat_on_floor) x.z = floor_z;
  vec4 seen = view * vec4(x, 1.0);
  eye = seen.xyz;
  normal = mat3(view) * mix(n0, n1, part);
  gl_Position = projection * seen;
  gl_Position.z -= bias * gl_Position.w;
  gl_PointSize = point_size;
  vec2 q = mix(q0, q1, part), e = mix(e0, e1, part);
  value = channel == 0 ? e.x : channel == 1 ? q.x : channel == 2 ? e.y : q.y;
}`;

// Smooth where the surface is. Where the normals of the vertices tell nothing (a crease) or a fold is
// too sharp for them, the normal is the triangle's own, from the derivatives of the position. Light
// from all around, the sky, a lamp and the eye, and a little gloss.
const BODY = `#version 300 es
precision highp float;
in vec3 eye, normal;
in float value;
uniform mat4 view;
uniform sampler2D colours;
uniform vec4 plain;
uniform bool coloured;
out vec4 colour;
void main() {
  vec3 face = normalize(cross(dFdx(eye), dFdy(eye)));
  if (dot(face, eye) > 0.0) face = -face;
  vec3 smooth_n = length(normal) > 0.01 ? normalize(normal) : face;
  if (dot(smooth_n, face) < 0.0) smooth_n = -smooth_n;
  vec3 n = normalize(mix(face, smooth_n, smoothstep(0.5, 0.75, dot(smooth_n, face))));
  vec3 lamp = normalize(vec3(-0.45, 0.75, 0.70)), to_eye = normalize(-eye);
  float sky = 0.5 + 0.5 * dot(n, mat3(view) * vec3(0.0, 0.0, 1.0));
  float light = 0.47 + 0.16 * sky + 0.17 * max(dot(n, lamp), 0.0) + 0.20 * max(dot(n, to_eye), 0.0);
  float gloss = 0.08 * pow(max(dot(n, normalize(lamp + to_eye)), 0.0), 30.0);
  vec3 base = coloured ? texture(colours, vec2((0.5 + 255.0 * value) / 256.0, 0.5)).rgb : plain.rgb;
  colour = vec4(base * light + gloss, 1.0);
}`;

// One colour: of a dot, with a ring; of a shadow, a net; or the body's, of which its edges are the contrast.
const PLAIN = `#version 300 es
precision highp float;
in vec3 eye, normal;
in float value;
uniform sampler2D colours;
uniform vec4 plain;
uniform bool round, coloured, contrast;
out vec4 colour;
void main() {
  float r = round ? length(gl_PointCoord - 0.5) : 0.0;
  if (r > 0.5) discard;
  colour = r > 0.34 ? vec4(1.0) : plain;
  if (!contrast) return;
  vec3 base = coloured ? texture(colours, vec2((0.5 + 255.0 * value) / 256.0, 0.5)).rgb : plain.rgb;
  colour.rgb = vec3(dot(base, vec3(0.30, 0.59, 0.11)) < 0.38 ? 1.0 : 0.0);
}`;

const FLOOR_VERTEX = `#version 300 es
precision highp float;
uniform mat4 view, projection;
uniform vec3 centre;
uniform float extent;
out vec2 at;
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  at = centre.xy + extent * corner;
  gl_Position = projection * view * vec4(at, centre.z, 1.0);
}`;

// A grid that fades out, without moire far away.
const FLOOR = `#version 300 es
precision highp float;
in vec2 at;
uniform vec3 centre;
uniform float extent, spacing;
uniform vec4 plain;
out vec4 colour;
void main() {
  vec2 cell = at / spacing;
  vec2 width = max(fwidth(cell), vec2(1e-6));
  vec2 off = abs(fract(cell - 0.5) - 0.5) / width;
  float line = 1.0 - min(min(off.x, off.y), 1.0);
  line *= 1.0 - smoothstep(0.25, 0.7, max(width.x, width.y));
  float fade = 1.0 - smoothstep(0.35, 1.0, length(at - centre.xy) / extent);
  colour = vec4(plain.rgb, fade * (0.05 + 0.33 * line));
}`;
