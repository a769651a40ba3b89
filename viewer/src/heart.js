// The heart's surface and its trees as the graphics card draws them.

import {
  BufferAttribute, BufferGeometry, DoubleSide, LineSegments, Mesh, ShaderMaterial,
} from "three";
import { positions, values, whole } from "./data.js";
import { texture } from "./colours.js";

const FRONT = 8; // ms that the front is bright
const ISOCHRONES = 10; // ms

const VERTEX = `
attribute float value;
varying float vValue; varying vec3 vNormal;
void main() {
  vValue = value;
  vNormal = normalize(normalMatrix * normal);
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;

// What has no value is marked by one far below zero, so that triangles at its border are grey, too.
const FRAGMENT = `
uniform sampler2D map; uniform float low, high, time, opacity; uniform bool ofTime, whole;
varying float vValue; varying vec3 vNormal;
const vec3 NONE = vec3(0.55), REST = vec3(0.86, 0.84, 0.82), BRIGHT = vec3(1.0, 0.55, 0.25);
void main() {
  float light = 0.5 + 0.5 * abs(normalize(vNormal).z);
  vec3 colour = NONE;
  if (vValue >= low - 0.5) {
    colour = texture2D(map, vec2((vValue - low) / (high - low), 0.5)).rgb;
    if (ofTime) {
      float line = vValue / ${ISOCHRONES.toFixed(1)};
      float away = abs(fract(line - 0.5) - 0.5) / max(fwidth(line), 1e-6);
      colour *= mix(0.55, 1.0, smoothstep(0.5, 1.3, away));
      if (!whole) {
        float since = (time - vValue) / ${FRONT.toFixed(1)};
        colour = since < 0.0 ? REST : mix(BRIGHT, colour, min(since, 1.0));
      }
    }
  }
  gl_FragColor = vec4(colour * light, opacity);
  #include <colorspace_fragment>
}`;

const TREE_VERTEX = `
attribute float value; varying float vValue;
void main() {
  vValue = value;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;

const TREE_FRAGMENT = `
uniform float time; varying float vValue;
void main() {
  gl_FragColor = vec4(vValue <= time ? vec3(0.83, 0.3, 0.0) : vec3(0.25), 1.0);
  #include <colorspace_fragment>
}`;

const FAR_BELOW = -1e6;
const marked = (array) => array.map((value) => (Number.isNaN(value) ? FAR_BELOW : value));

export class Heart {
  constructor(surface, box) {
    this.index = whole(surface.index);
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(positions(surface.vertices, box), 3));
    geometry.setIndex(new BufferAttribute(whole(surface.triangles), 1));
    geometry.computeVertexNormals();
    geometry.setAttribute("value", new BufferAttribute(new Float32Array(this.index.length), 1));
    this.maps = { time: texture("time"), scalar: texture("scalar") };
    const uniforms = {
      map: { value: null }, low: { value: 0 }, high: { value: 1 }, time: { value: 0 },
      opacity: { value: 1 }, ofTime: { value: true }, whole: { value: true },
    };
    const material = new ShaderMaterial({
      uniforms, vertexShader: VERTEX, fragmentShader: FRAGMENT, side: DoubleSide,
    });
    this.mesh = new Mesh(geometry, material);
    this.uniforms = uniforms;
  }

  show(field) {
    this.field = field;
    this.values = values(field);
    const attribute = this.mesh.geometry.getAttribute("value");
    attribute.array.set(marked(Float32Array.from(this.index, (k) => this.values[k])));
    attribute.needsUpdate = true;
    const u = this.uniforms;
    u.map.value = this.maps[field.kind];
    u.low.value = field.low;
    u.high.value = field.high;
    u.ofTime.value = field.kind === "time";
  }

  at(time, duration) {
    this.uniforms.time.value = time;
    this.uniforms.whole.value = time >= duration;
  }

  seeThrough(yes) {
    this.uniforms.opacity.value = yes ? 0.35 : 1;
    this.mesh.material.transparent = yes;
    this.mesh.material.depthWrite = !yes;
  }

  // The vertex of a triangle that is nearest to a point.
  nearest(face, point) {
    const place = this.mesh.geometry.getAttribute("position");
    let best = [Infinity, face.a];
    for (const vertex of [face.a, face.b, face.c]) {
      const apart = Math.hypot(
        place.getX(vertex) - point.x, place.getY(vertex) - point.y, place.getZ(vertex) - point.z,
      );
      if (apart < best[0]) best = [apart, vertex];
    }
    return best[1];
  }

  valueAt(vertex) {
    return this.values[this.index[vertex]];
  }

  dispose() {
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
    Object.values(this.maps).forEach((map) => map.dispose());
  }
}

export function treeLines(tree, box) {
  const nodes = positions(tree.nodes, box);
  const times = marked(values(tree)).map((t) => (t === FAR_BELOW ? Infinity : t));
  const segments = whole(tree.segments);
  const place = new Float32Array(3 * segments.length);
  const when = new Float32Array(segments.length);
  segments.forEach((node, k) => {
    place.set(nodes.subarray(3 * node, 3 * node + 3), 3 * k);
    when[k] = Math.min(times[node], 1e6);
  });
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(place, 3));
  geometry.setAttribute("value", new BufferAttribute(when, 1));
  const material = new ShaderMaterial({
    uniforms: { time: { value: 0 } }, vertexShader: TREE_VERTEX, fragmentShader: TREE_FRAGMENT,
  });
  return new LineSegments(geometry, material);
}
