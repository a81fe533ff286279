// Rigs in a report, turned by mouse, touch and keys. Drawn without a graphics driver: a z-buffer over a few thousand
// triangles, in the manner of riglab-render. `PALETTES` stands before this script; the format is told in view/mod.rs.
"use strict";
(() => {
  const SWING = 25 * Math.PI / 180;
  const GREY = [0.72, 0.73, 0.75];

  /** A view's bytes as arrays. */
  function decode(base64) {
    const text = atob(base64.trim());
    const bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    const data = new DataView(bytes.buffer);
    const head = data.getUint32(4, true);
    const info = JSON.parse(new TextDecoder().decode(bytes.subarray(8, 8 + head)));
    let at = 8 + head;
    const u16 = (n) => {
      const out = new Uint16Array(n);
      for (let i = 0; i < n; i++, at += 2) out[i] = data.getUint16(at, true);
      return out;
    };
    const { vertices, triangles, low, size } = info;
    const rest = Float32Array.from(u16(3 * vertices), (q, i) => low[i % 3] + size * q / 65535);
    const faces = u16(3 * triangles);
    const versions = info.versions.map((v) => {
      const heads = Float32Array.from(u16(3 * v.parents.length), (q, i) => low[i % 3] + size * q / 65535);
      const joints = u16(4 * vertices);
      const weights = Float32Array.from(bytes.subarray(at, at + 4 * vertices), (w) => w / 255);
      at += 4 * vertices;
      return { ...v, heads, joints, weights };
    });
    return { ...info, rest, faces, versions };
  }

  const hex = (text) => [1, 3, 5].map((k) => parseInt(text.slice(k, k + 2), 16) / 255);
  const joints = PALETTES.joints.map(hex);
  const ramps = { dusk: PALETTES.dusk.map(hex), ember: PALETTES.ember.map(hex) };
  const jointColor = (j) => joints[j % joints.length];
  function ramp(name, value) {
    const table = ramps[name];
    const at = Math.min(Math.max(value, 0), 1) * (table.length - 1);
    const low = Math.min(Math.floor(at), table.length - 2);
    return table[low].map((c, k) => c + (table[low + 1][k] - c) * (at - low));
  }

  /** The weight of a joint on a vertex. */
  function weight(version, v, joint) {
    for (let k = 4 * v; k < 4 * v + 4; k++) if (version.joints[k] === joint) return version.weights[k];
    return 0;
  }

  /** The share of a vertex's weight that is on another joint than in the other version. */
  function misplaced(a, b, v) {
    let shared = 0;
    for (let k = 4 * v; k < 4 * v + 4; k++) {
      if (a.weights[k] > 0) shared += Math.min(a.weights[k], weight(b, v, a.joints[k]));
    }
    return 1 - shared;
  }

  /** A colour for each vertex. */
  function paint(model, state) {
    const version = model.versions[state.version];
    const out = new Float32Array(3 * model.vertices);
    for (let v = 0; v < model.vertices; v++) {
      let c = GREY;
      if (state.paint === "parts") {
        c = [0, 0, 0];
        for (let k = 4 * v; k < 4 * v + 4; k++) {
          const w = version.weights[k];
          if (w > 0) jointColor(version.joints[k]).forEach((x, i) => { c[i] += w * x; });
        }
      } else if (state.paint === "bone") {
        const w = weight(version, v, state.bone);
        if (w >= 0.01) c = ramp("dusk", w);
      } else if (state.paint === "misplaced") {
        c = ramp("ember", misplaced(model.versions[0], model.versions[1], v) / 0.5);
      }
      out.set(c, 3 * v);
    }
    return out;
  }

  /** Each joint's map from rest to pose: every joint swings once, a little after the one before; null at rest. */
  function pose(version, time) {
    const n = version.parents.length;
    if (time <= 0 || n === 0) return null;
    const whole = duration(version);
    const apart = (whole - 1) / (Math.max(n, 2) - 1);
    const maps = new Float32Array(12 * n);
    for (let j = 0; j < n; j++) {
      const t = time - apart * j;
      const angle = t > 0 && t < 1 ? SWING * Math.sin(2 * Math.PI * t) : 0;
      const [sin, cos] = [Math.sin(angle), Math.cos(angle)];
      // Across the bone: about x, or about z for bones along x.
      const m = version.alongX[j] ? [cos, -sin, 0, sin, cos, 0, 0, 0, 1] : [1, 0, 0, 0, cos, -sin, 0, sin, cos];
      const h = version.heads.subarray(3 * j, 3 * j + 3);
      const shift = [0, 1, 2].map((r) => h[r] - m[3 * r] * h[0] - m[3 * r + 1] * h[1] - m[3 * r + 2] * h[2]);
      const p = version.parents[j];
      for (let r = 0; r < 3; r++) {
        for (let c = 0; c < 4; c++) {
          const own = (row) => (c < 3 ? m[3 * row + c] : shift[row]);
          if (p < 0) {
            maps[12 * j + 4 * r + c] = own(r);
          } else {
            const a = 12 * p + 4 * r;
            const sum = maps[a] * own(0) + maps[a + 1] * own(1) + maps[a + 2] * own(2);
            maps[12 * j + 4 * r + c] = c < 3 ? sum : sum + maps[a + 3];
          }
        }
      }
    }
    return maps;
  }
  const duration = (version) => Math.min(Math.max(2 + 0.06 * version.parents.length, 2.5), 8);

  function moved(maps, j, p, at, out, to, w) {
    const m = 12 * j;
    for (let r = 0; r < 3; r++) {
      const k = m + 4 * r;
      out[to + r] += w * (maps[k] * p[at] + maps[k + 1] * p[at + 1] + maps[k + 2] * p[at + 2] + maps[k + 3]);
    }
  }

  /** Vertices and heads in the pose. */
  function posed(model, version, maps) {
    if (!maps) return [model.rest, version.heads];
    const points = new Float32Array(model.rest.length);
    for (let v = 0; v < model.vertices; v++) {
      let total = 0;
      for (let k = 4 * v; k < 4 * v + 4; k++) {
        const w = version.weights[k];
        if (w > 0) { moved(maps, version.joints[k], model.rest, 3 * v, points, 3 * v, w); total += w; }
      }
      for (let r = 0; r < 3; r++) points[3 * v + r] = total > 0 ? points[3 * v + r] / total : model.rest[3 * v + r];
    }
    const heads = new Float32Array(version.heads.length);
    for (let j = 0; j < version.parents.length; j++) moved(maps, j, version.heads, 3 * j, heads, 3 * j, 1);
    return [points, heads];
  }

  /** Points on the screen: x, y in pixels, z towards the eye. */
  function project(points, model, state, width, height) {
    const out = new Float32Array(points.length);
    const [sy, cy, sp, cp] = [Math.sin(state.yaw), Math.cos(state.yaw), Math.sin(state.pitch), Math.cos(state.pitch)];
    const scale = 0.9 * Math.min(width / model.wide, height / model.tall) * state.zoom;
    for (let i = 0; i < points.length; i += 3) {
      const x = points[i] - model.middle[0], y = points[i + 1] - model.middle[1], z = points[i + 2] - model.middle[2];
      const rx = cy * x + sy * z, rz = cy * z - sy * x;
      out[i] = width / 2 + scale * rx;
      out[i + 1] = height / 2 - scale * (cp * y - sp * rz);
      out[i + 2] = scale * (cp * rz + sp * y);
    }
    return out;
  }

  /** The mesh, lit from the eye's side and a little from above. */
  function raster(screen, faces, colors, width, height) {
    const image = new ImageData(width, height);
    const pixels = image.data;
    const depth = new Float32Array(width * height).fill(-Infinity);
    const normals = new Float32Array(screen.length);
    for (let f = 0; f < faces.length; f += 3) {
      const [a, b, c] = [3 * faces[f], 3 * faces[f + 1], 3 * faces[f + 2]];
      const ux = screen[b] - screen[a], uy = screen[b + 1] - screen[a + 1], uz = screen[b + 2] - screen[a + 2];
      const vx = screen[c] - screen[a], vy = screen[c + 1] - screen[a + 1], vz = screen[c + 2] - screen[a + 2];
      const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
      for (const k of [a, b, c]) { normals[k] += nx; normals[k + 1] += ny; normals[k + 2] += nz; }
    }
    const lit = new Float32Array(screen.length);
    for (let k = 0; k < screen.length; k += 3) {
      const length = Math.hypot(normals[k], normals[k + 1], normals[k + 2]) || 1;
      const toEye = Math.abs(normals[k + 2]) / length;
      const up = (normals[k + 2] < 0 ? 1 : -1) * normals[k + 1] / length;
      const light = Math.min(1, 0.42 + 0.5 * toEye + 0.12 * up);
      for (let r = 0; r < 3; r++) lit[k + r] = 255 * light * colors[k + r];
    }
    for (let f = 0; f < faces.length; f += 3) {
      const [a, b, c] = [3 * faces[f], 3 * faces[f + 1], 3 * faces[f + 2]];
      const x0 = screen[a], y0 = screen[a + 1], x1 = screen[b], y1 = screen[b + 1], x2 = screen[c], y2 = screen[c + 1];
      const area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0);
      if (!(Math.abs(area) > 1e-6)) continue;
      const left = Math.max(0, Math.ceil(Math.min(x0, x1, x2) - 0.5));
      const right = Math.min(width - 1, Math.floor(Math.max(x0, x1, x2) - 0.5));
      const top = Math.max(0, Math.ceil(Math.min(y0, y1, y2) - 0.5));
      const bottom = Math.min(height - 1, Math.floor(Math.max(y0, y1, y2) - 0.5));
      const dx1 = (y2 - y0) / area, dy1 = -(x2 - x0) / area, dx2 = -(y1 - y0) / area, dy2 = (x1 - x0) / area;
      for (let y = top; y <= bottom; y++) {
        let w1 = (left + 0.5 - x0) * dx1 + (y + 0.5 - y0) * dy1;
        let w2 = (left + 0.5 - x0) * dx2 + (y + 0.5 - y0) * dy2;
        for (let x = left; x <= right; x++, w1 += dx1, w2 += dx2) {
          const w0 = 1 - w1 - w2;
          if (w0 < -1e-4 || w1 < -1e-4 || w2 < -1e-4) continue;
          const z = w0 * screen[a + 2] + w1 * screen[b + 2] + w2 * screen[c + 2];
          const at = y * width + x;
          if (z <= depth[at]) continue;
          depth[at] = z;
          for (let r = 0; r < 3; r++) pixels[4 * at + r] = w0 * lit[a + r] + w1 * lit[b + r] + w2 * lit[c + r];
          pixels[4 * at + 3] = 255;
        }
      }
    }
    return image;
  }

  /** Bones and joints over the mesh, the chosen one last and largest. */
  function skeleton(context, version, heads, state, unit) {
    const order = version.parents.map((_, j) => j).filter((j) => j !== state.bone).concat([state.bone]);
    const css = (c) => `rgb(${c.map((x) => Math.round(255 * x)).join(",")})`;
    context.lineCap = "round";
    for (const dark of [true, false]) {
      for (const j of order) {
        const p = version.parents[j];
        if (p === undefined) continue;
        const chosen = j === state.bone && state.paint === "bone";
        context.strokeStyle = context.fillStyle = dark ? "rgba(12,14,18,.85)" : chosen ? "#fff" : css(jointColor(j));
        context.lineWidth = unit * ((chosen ? 3.4 : 1.8) + (dark ? 1.8 : 0));
        if (p >= 0) {
          context.beginPath();
          context.moveTo(heads[3 * p], heads[3 * p + 1]);
          context.lineTo(heads[3 * j], heads[3 * j + 1]);
          context.stroke();
        }
        context.beginPath();
        context.arc(heads[3 * j], heads[3 * j + 1], unit * ((chosen ? 4.4 : 2.6) + (dark ? 1 : 0)), 0, 2 * Math.PI);
        context.fill();
      }
    }
  }

  /** What is measured once of a model. */
  function prepare(model) {
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (let i = 0; i < model.rest.length; i++) {
      low[i % 3] = Math.min(low[i % 3], model.rest[i]);
      high[i % 3] = Math.max(high[i % 3], model.rest[i]);
    }
    model.middle = low.map((l, k) => (l + high[k]) / 2);
    // However it is turned about its height, it fits.
    model.wide = Math.hypot(high[0] - low[0], high[2] - low[2]) || 1e-6;
    model.tall = high[1] - low[1] + 0.22 * model.wide;
    for (const version of model.versions) {
      version.alongX = version.parents.map((_, j) => {
        const child = version.parents.indexOf(j);
        if (child < 0) return false;
        const d = [0, 1, 2].map((k) => version.heads[3 * child + k] - version.heads[3 * j + k]);
        return Math.abs(d[0]) > 0.8 * Math.hypot(...d);
      });
    }
    return model;
  }

  function start(figure) {
    const model = prepare(decode(figure.querySelector("script").textContent));
    const canvas = figure.querySelector("canvas");
    const context = canvas.getContext("2d");
    const find = (name) => figure.querySelector(`[data-view=${name}]`);
    const home = { yaw: -0.6, pitch: 0.22, zoom: 1 };
    const state = { version: model.versions.length - 1, paint: "parts", bone: 0, skeleton: true, playing: false, time: 0, ...home };
    const buffer = document.createElement("canvas");
    let colors = null, asked = false, fine = 0, last = 0;

    function draw(now) {
      asked = false;
      if (state.playing) {
        const version = model.versions[state.version];
        state.time = (state.time + Math.min((now - last) / 1000, 0.1)) % duration(version);
        state.time = Math.max(state.time, 1e-4);
      }
      last = now;
      const dots = Math.min(window.devicePixelRatio || 1, 2);
      const width = Math.max(1, Math.round(canvas.clientWidth * dots));
      const height = Math.max(1, Math.round(canvas.clientHeight * dots));
      if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
      // Quick while it moves, with four samples a pixel once it stands.
      const scale = now >= fine && !state.playing ? Math.min(2, 1600 / width) : Math.min(1, 640 / width);
      const [w, h] = [Math.max(1, Math.round(width * scale)), Math.max(1, Math.round(height * scale))];
      const version = model.versions[state.version];
      const [points, heads] = posed(model, version, pose(version, state.time));
      colors = colors || paint(model, state);
      Object.assign(buffer, { width: w, height: h });
      buffer.getContext("2d").putImageData(raster(project(points, model, state, w, h), model.faces, colors, w, h), 0, 0);
      context.clearRect(0, 0, width, height);
      context.imageSmoothingQuality = "high";
      context.drawImage(buffer, 0, 0, width, height);
      if (state.skeleton) skeleton(context, version, project(heads, model, state, width, height), state, dots);
      figure.dataset.drawn = String(Number(figure.dataset.drawn || 0) + 1);
      if (state.playing) again();
      else if (now < fine) setTimeout(again, fine - now + 10);
    }
    function again() {
      if (!asked) { asked = true; requestAnimationFrame(draw); }
    }
    /** Something moves: draw quickly now, and well a little later. */
    function moving() { fine = performance.now() + 150; again(); }

    function show() {
      colors = null;
      const version = model.versions[state.version];
      figure.querySelectorAll("[data-version]").forEach((b) => b.setAttribute("aria-pressed", String(+b.dataset.version === state.version)));
      find("paint").value = state.paint;
      const bones = find("bone");
      if (bones.dataset.of !== String(state.version)) {
        bones.dataset.of = String(state.version);
        bones.replaceChildren(...version.names.map((name, j) => new Option(`${j + 1}: ${name}`, j)));
        state.bone = Math.min(state.bone, version.names.length - 1);
      }
      bones.value = String(state.bone);
      find("play").textContent = state.playing ? "Pause" : "Play";
      find("play").setAttribute("aria-pressed", String(state.playing));
      find("skeleton").checked = state.skeleton;
      find("said").textContent = state.paint === "bone" ? `weight of ${version.names[state.bone] ?? "no bone"}, from 0 (grey) through violet to 1 (yellow)`
        : state.paint === "misplaced" ? "share of weight on a wrong joint, from 0 (pale) to a half or more (crimson)"
        : state.paint === "parts" ? "each joint's colour, mixed by weight" : "the mesh alone";
      again();
    }
    const set = (change) => { Object.assign(state, change); show(); };
    const turn = (yaw, pitch) => {
      state.yaw += yaw;
      state.pitch = Math.min(Math.max(state.pitch + pitch, -1.5), 1.5);
      moving();
    };
    const zoom = (by) => { state.zoom = Math.min(Math.max(state.zoom * by, 0.4), 8); moving(); };
    const play = () => set({ playing: !state.playing });
    const bone = (by) => {
      const n = model.versions[state.version].names.length;
      if (n > 0) set({ bone: (state.bone + by + n) % n, paint: "bone" });
    };
    const reset = () => set({ ...home, playing: false, time: 0 });
    const next = () => set({ version: (state.version + 1) % model.versions.length });

    figure.querySelectorAll("[data-version]").forEach((b) => b.addEventListener("click", () => set({ version: +b.dataset.version })));
    find("paint").addEventListener("change", (e) => set({ paint: e.target.value }));
    find("bone").addEventListener("change", (e) => set({ bone: +e.target.value, paint: "bone" }));
    find("skeleton").addEventListener("change", (e) => set({ skeleton: e.target.checked }));
    find("play").addEventListener("click", play);
    find("reset").addEventListener("click", reset);
    const keys = {
      ArrowLeft: () => turn(-0.12, 0), ArrowRight: () => turn(0.12, 0), ArrowUp: () => turn(0, 0.12), ArrowDown: () => turn(0, -0.12),
      "+": () => zoom(1.15), "=": () => zoom(1.15), "-": () => zoom(1 / 1.15), " ": play, p: play,
      t: next, b: () => bone(1), B: () => bone(-1), s: () => set({ skeleton: !state.skeleton }), "0": reset,
    };
    canvas.addEventListener("keydown", (e) => {
      if (e.ctrlKey || e.metaKey || e.altKey || !Object.hasOwn(keys, e.key)) return;
      e.preventDefault();
      keys[e.key]();
    });
    const fingers = new Map();
    canvas.addEventListener("pointerdown", (e) => {
      fingers.set(e.pointerId, [e.clientX, e.clientY]);
      canvas.setPointerCapture(e.pointerId);
    });
    canvas.addEventListener("pointermove", (e) => {
      const old = fingers.get(e.pointerId);
      if (!old) return;
      const apart = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
      const was = fingers.size === 2 ? apart() : 0;
      fingers.set(e.pointerId, [e.clientX, e.clientY]);
      if (was > 0) zoom(apart() / was);
      else if (fingers.size === 1) turn((e.clientX - old[0]) * 0.01, (e.clientY - old[1]) * 0.01);
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (e) => fingers.delete(e.pointerId));
    // The wheel scrolls the page unless the view was chosen.
    canvas.addEventListener("wheel", (e) => {
      if (document.activeElement !== canvas) return;
      e.preventDefault();
      zoom(Math.exp(-e.deltaY * 0.0015));
    }, { passive: false });
    new ResizeObserver(again).observe(canvas);
    show();
  }

  // A view is read when it comes near the screen.
  const seen = new IntersectionObserver((entries) => {
    for (const entry of entries.filter((e) => e.isIntersecting)) {
      seen.unobserve(entry.target);
      start(entry.target);
    }
  }, { rootMargin: "300px" });
  document.querySelectorAll("figure.view").forEach((figure) => seen.observe(figure));
})();
