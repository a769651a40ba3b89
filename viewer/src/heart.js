// The heart's surface and its Purkinje trees as the graphics card draws them: in one colour map,
// with one front.

import {
  BufferAttribute, BufferGeometry, DoubleSide, Mesh, ShaderMaterial, Vector2,
} from "three";
import { positions, values, whole } from "./data.js";
import { texture } from "./colours.js";

const FRONT = 8; // ms that the front is bright
const ISOCHRONES = 10; // ms
const TREE_WIDTH = 3.6; // CSS pixels, with the dark edge

const COLOURED = `
uniform sampler2D map; uniform float low, high, time; uniform bool ofTime, whole;
const vec3 NONE = vec3(0.55), BRIGHT = vec3(1.0, 0.55, 0.25);
vec3 coloured(float value) {
  return texture2D(map, vec2((value - low) / (high - low), 0.5)).rgb;
}
vec3 withFront(vec3 colour, vec3 rest, float value) {
  float since = (time - value) / ${FRONT.toFixed(1)};
  return since < 0.0 ? rest : mix(BRIGHT, colour, min(since, 1.0));
}`;

const VERTEX = `
#include <clipping_planes_pars_vertex>
attribute float value, scar;
varying float vValue, vScar; varying vec3 vNormal, vPlace;
void main() {
  vValue = value;
  vScar = scar;
  vPlace = position;
  vNormal = normalize(normalMatrix * normal);
  vec4 mvPosition = modelViewMatrix * vec4(position, 1.0);
  #include <clipping_planes_vertex>
  gl_Position = projectionMatrix * mvPosition;
}`;

// What has no value is marked by one far below zero, so that triangles at its border are grey, too.
// A translucent wall is clearer where it faces the eye. Scar is hatched, 2.5 mm apart.
const FRAGMENT = `
#include <clipping_planes_pars_fragment>
uniform bool translucent;
varying float vValue, vScar; varying vec3 vNormal, vPlace;
const vec3 REST = vec3(0.86, 0.84, 0.82);
${COLOURED}
void main() {
  #include <clipping_planes_fragment>
  float facing = abs(normalize(vNormal).z);
  vec3 colour = NONE;
  if (vValue >= low - 0.5) {
    colour = coloured(vValue);
    if (ofTime) {
      float line = vValue / ${ISOCHRONES.toFixed(1)};
      float away = abs(fract(line - 0.5) - 0.5) / max(fwidth(line), 1e-6);
      colour *= mix(0.55, 1.0, smoothstep(0.5, 1.3, away));
      if (!whole) colour = withFront(colour, REST, vValue);
    }
  }
  if (vScar > 0.5 && fract((vPlace.x + vPlace.y + vPlace.z) / 2.5) < 0.4) colour *= 0.25;
  float opacity = translucent ? mix(0.6, 0.16, facing) : 1.0;
  gl_FragColor = vec4(colour * (0.5 + 0.5 * facing), opacity);
  #include <colorspace_fragment>
}`;

// A segment is a band that faces the eye, from one end to the other, of some pixels in width.
const TREE_VERTEX = `
attribute vec3 end; attribute vec2 corner, times;
uniform vec2 size; uniform float width;
varying float vValue, vAcross;
void main() {
  vec4 from = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  vec4 to = projectionMatrix * modelViewMatrix * vec4(end, 1.0);
  vec2 along = (to.xy / to.w - from.xy / from.w) * size;
  along = length(along) > 1e-6 ? normalize(along) : vec2(1.0, 0.0);
  vec4 place = mix(from, to, corner.x);
  vec2 offset = corner.y * vec2(-along.y, along.x) + (2.0 * corner.x - 1.0) * along * 0.5;
  place.xy += offset * width / size * place.w;
  gl_Position = place;
  vValue = times.x < -1e5 || times.y < -1e5 ? -1e6 : mix(times.x, times.y, corner.x);
  vAcross = corner.y;
}`;

const TREE_FRAGMENT = `
varying float vValue, vAcross;
const vec3 REST = vec3(0.6);
${COLOURED}
void main() {
  vec3 colour = REST, edge = REST * 0.4;
  if (ofTime && vValue > -1e5) {
    colour = coloured(vValue);
    if (!whole) colour = withFront(colour, REST, vValue);
    if (whole || vValue <= time) edge = colour * 0.08;
  }
  gl_FragColor = vec4(abs(vAcross) > 0.62 ? edge : colour, 1.0);
  #include <colorspace_fragment>
}`;

const NONE = -1e6;
const TRIANGLES = [0, 2, 1, 1, 2, 3]; // of the corners of a segment

// Copies values, NaN as what is far below all others.
function mark(into, given, index) {
  for (let k = 0; k < index.length; k++) {
    const value = given[index[k]];
    into[k] = Number.isFinite(value) ? value : NONE;
  }
}

export class Heart {
  constructor(surface, box) {
    this.index = whole(surface.index);
    this.triangles = whole(surface.triangles);
    this.endocardial = surface.endocardial ?? 0; // so many triangles come first
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(positions(surface.vertices, box), 3));
    geometry.setIndex(new BufferAttribute(this.triangles, 1));
    geometry.computeVertexNormals();
    const scar = new Float32Array(this.index.length);
    for (const vertex of whole(surface.scar ?? new Uint32Array())) scar[vertex] = 1;
    geometry.setAttribute("scar", new BufferAttribute(scar, 1));
    geometry.setAttribute("value", new BufferAttribute(new Float32Array(this.index.length), 1));
    this.maps = { time: texture("time"), scalar: texture("scalar"), red: texture("red") };
    this.early = "time"; // the map of activation times, or "red"
    // shared with the trees
    this.shared = {
      map: { value: null }, low: { value: 0 }, high: { value: 1 }, time: { value: 0 },
      ofTime: { value: true }, whole: { value: true },
    };
    this.translucent = { value: false };
    this.material = new ShaderMaterial({
      uniforms: { ...this.shared, translucent: this.translucent }, vertexShader: VERTEX,
      fragmentShader: FRAGMENT, side: DoubleSide, clipping: true,
    });
    this.mesh = new Mesh(geometry, this.material);
    // of all trees, one after the other: a new material each would be compiled each time
    this.size = new Vector2(1, 1); // of the picture (CSS pixels)
    this.ofTrees = new ShaderMaterial({
      uniforms: { ...this.shared, size: { value: this.size }, width: { value: TREE_WIDTH } },
      vertexShader: TREE_VERTEX, fragmentShader: TREE_FRAGMENT, side: DoubleSide,
    });
  }

  // Moves the vertices to the positions (x, y, z, x, …) of another heart.
  place(points) {
    const { geometry } = this.mesh;
    const attribute = geometry.getAttribute("position");
    attribute.array.set(points);
    attribute.needsUpdate = true;
    geometry.computeVertexNormals();
    geometry.computeBoundingSphere();
  }

  // A field {values, low, high, kind}, of which the values are in base64 or a Float32Array.
  show(field) {
    this.field = field;
    const u = this.shared;
    u.map.value = this.maps[field.kind === "time" ? this.early : field.kind];
    u.low.value = field.low;
    u.high.value = field.high;
    u.ofTime.value = field.kind === "time";
    this.update(values(field));
  }

  // Other values of the same field, as often as the screen is drawn.
  update(given) {
    this.values = given;
    const attribute = this.mesh.geometry.getAttribute("value");
    mark(attribute.array, given, this.index);
    attribute.needsUpdate = true;
  }

  // Which colours activation times have: "time", early is light, or "red", early is red.
  colourTimes(name) {
    this.early = name;
    if (this.field?.kind === "time") this.shared.map.value = this.maps[name];
  }

  at(time, duration) {
    this.shared.time.value = time;
    this.shared.whole.value = time >= duration;
  }

  seeThrough(yes) {
    this.translucent.value = yes;
    this.material.transparent = yes;
    this.material.depthWrite = !yes;
  }

  onlyEndocardia(yes) {
    this.mesh.geometry.setDrawRange(0, yes ? 3 * this.endocardial : Infinity);
  }

  // Cuts away what is on the far side of a plane; null cuts nothing.
  cutBy(plane) {
    this.material.clippingPlanes = plane && [plane];
  }

  // Where a ray first meets what is shown of the surface, with the nearest `vertex`; or null.
  hit(ray) {
    const planes = this.material.clippingPlanes ?? [];
    const there = ({ point }) => planes.every((plane) => plane.distanceToPoint(point) >= 0);
    const found = ray.intersectObject(this.mesh).find(there);
    return found ? { ...found, vertex: this.nearest(found.face, found.point) } : null;
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
    this.material.dispose();
    this.ofTrees.dispose();
    Object.values(this.maps).forEach((map) => map.dispose());
  }
}

export class Tree {
  // A tree {nodes, segments, times, low, high} in the colours, and with the front, of a heart.
  constructor(tree, box, heart) {
    this.nodes = positions(tree.nodes, box);
    this.segments = whole(tree.segments);
    // four corners a segment, not an instance each: software drawing takes 20 µs an instance
    const count = this.segments.length / 2;
    const corners = new Float32Array(8 * count);
    const ends = [new Float32Array(12 * count), new Float32Array(12 * count)];
    const index = new Uint32Array(6 * count);
    this.corners = new Uint32Array(8 * count); // the two nodes of each corner's segment
    for (let k = 0; k < count; k++) {
      for (let n = 0; n < 6; n++) index[6 * k + n] = 4 * k + TRIANGLES[n];
      for (let corner = 4 * k; corner < 4 * k + 4; corner++) {
        corners[2 * corner] = corner & 2 ? 1 : 0;
        corners[2 * corner + 1] = corner & 1 ? 1 : -1;
        for (let n = 0; n < 2; n++) {
          const node = this.segments[2 * k + n];
          this.corners[2 * corner + n] = node;
          for (let x = 0; x < 3; x++) ends[n][3 * corner + x] = this.nodes[3 * node + x];
        }
      }
    }
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(ends[0], 3));
    geometry.setAttribute("end", new BufferAttribute(ends[1], 3));
    geometry.setAttribute("corner", new BufferAttribute(corners, 2));
    geometry.setAttribute("times", new BufferAttribute(new Float32Array(8 * count), 2));
    geometry.setIndex(new BufferAttribute(index, 1));
    this.mesh = new Mesh(geometry, heart.ofTrees);
    this.mesh.frustumCulled = false; // its sphere knows nothing of the ends
    this.mesh.onBeforeRender = (renderer) => renderer.getSize(heart.size);
    this.update(values(tree));
  }

  // Other times of the nodes (ms), as often as the screen is drawn.
  update(times) {
    const attribute = this.mesh.geometry.getAttribute("times");
    mark(attribute.array, times, this.corners);
    attribute.needsUpdate = true;
  }

  dispose() {
    this.mesh.geometry.dispose();
  }
}
