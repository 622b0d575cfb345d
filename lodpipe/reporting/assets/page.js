"use strict";
// The report's page: two viewers in step, a slider over the levels, and what changes with it.
// Everything it shows is in the page; nothing is ever fetched from a network.
(() => {
  const byId = (id) => document.getElementById(id);
  const all = (selector, root = document) => [...root.querySelectorAll(selector)];
  const { levels, shown, asset } = JSON.parse(byId("data").textContent);
  const ORBIT = "36.87deg 76.5deg 4.02m"; // the pictures' first direction; models have a radius of 1
  const FIELD = "30deg";
  const WIRES = { textured: 0x19c3ff, checker: 0x19c3ff, other: 0x101418 };
  const count = new Intl.NumberFormat("en").format;

  // --- what the page carries: compressed, as text

  const elements = new Map(all("script[data-blob]").map((element) => [element.dataset.blob, element]));

  function remembered(make) {
    const known = new Map();
    return (key) => {
      if (!known.has(key)) known.set(key, make(key));
      return known.get(key);
    };
  }

  const buffer = remembered(async (name) => {
    const letters = atob(elements.get(name).textContent);
    const packed = Uint8Array.from(letters, (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).arrayBuffer();
  });
  const text = async (name) => new TextDecoder().decode(await buffer(name));
  const address = remembered(async (name) =>
    URL.createObjectURL(new Blob([await buffer(name)], { type: elements.get(name).dataset.type })));

  // --- models: the textured one, and what is made of it

  const checker = remembered(() => {
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = 1024;
    const pen = canvas.getContext("2d");
    const cells = 16, size = canvas.width / cells;
    pen.font = `600 ${size * 0.42}px system-ui, sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    for (let row = 0; row < cells; row++) {
      for (let column = 0; column < cells; column++) {
        const even = (row + column) % 2 === 0;
        pen.fillStyle = `hsl(${(360 * column) / cells} ${even ? 55 : 45}% ${even ? 42 : 82}%)`;
        pen.fillRect(column * size, row * size, size, size);
        pen.fillStyle = even ? "#fff" : "#333";
        pen.fillText(String.fromCharCode(65 + column) + (row + 1), (column + 0.5) * size, (row + 0.5) * size);
      }
    }
    return new Promise((done) => canvas.toBlob((blob) => done(URL.createObjectURL(blob))));
  });

  const tree = remembered(async (name) => JSON.parse(await text(name)));

  function plain(gltf, texture) {
    const surface = { baseColorFactor: [0.36, 0.36, 0.38, 1], metallicFactor: 0, roughnessFactor: 0.7 };
    gltf.materials = [{ pbrMetallicRoughness: surface, doubleSided: true }];
    if (texture) {
      gltf.images = [{ uri: texture }];
      gltf.textures = [{ source: 0 }];
      gltf.samplers = [];
      const painted = { ...surface, baseColorFactor: [1, 1, 1, 1], baseColorTexture: { index: 0 } };
      gltf.materials.push({ pbrMetallicRoughness: painted, doubleSided: true });
    } else {
      gltf.images = gltf.textures = undefined;
    }
    for (const mesh of gltf.meshes) {
      for (const primitive of mesh.primitives) {
        delete primitive.attributes.COLOR_0;
        delete primitive.extensions;
        primitive.material = texture && "TEXCOORD_0" in primitive.attributes ? 1 : 0;
      }
    }
  }

  const source = remembered(async (key) => {
    const [look, level] = key.split(" ");
    const layer = layerNamed(look);
    const gltf = structuredClone(await tree((layer ? layer.models : shown.models)[level]));
    if (look === "clay") plain(gltf);
    if (look === "checker") plain(gltf, await checker(""));
    for (const part of [...(gltf.buffers ?? []), ...(gltf.images ?? [])]) {
      if (part.uri && !part.uri.startsWith("blob:")) part.uri = await address(part.uri);
    }
    return URL.createObjectURL(new Blob([JSON.stringify(gltf)], { type: "model/gltf+json" }));
  });

  // --- the two viewers

  const slider = byId("level");
  const look = document.querySelector("input[name=look]:checked").value;
  const state = { level: slider ? Number(slider.value) : 0, look, wires: false, view: 0 };
  const panes = ["left", "right"].map((side) => ({
    root: byId(side),
    stage: byId(side).querySelector(".stage"),
    still: byId(side).querySelector(".still"),
    caption: byId(side).querySelector("figcaption"),
    viewer: null,
    level: () => (side === "left" ? 0 : state.level),
  }));

  const layerNamed = (look) => shown.layers.find((one) => one.name === look);
  // beside the colours of a level stands the source as it looks
  const lookOf = (pane) => (pane === panes[0] && layerNamed(state.look)?.beside ? "textured" : state.look);

  function sceneOf(viewer) {
    const symbol = Object.getOwnPropertySymbols(viewer).find((one) => one.description === "scene");
    return symbol && viewer[symbol];
  }

  function drawWires(viewer) {
    const scene = sceneOf(viewer);
    if (!scene) return;
    const surfaces = [], old = [];
    scene.traverse((node) => node.isMesh && node.geometry && (node.userData.wires ? old : surfaces).push(node));
    old.forEach((node) => node.removeFromParent());
    for (const surface of state.wires ? surfaces.filter((node) => node.material?.isMeshStandardMaterial) : []) {
      const lines = surface.clone(false);
      const paint = surface.material.clone();
      for (const key of Object.keys(paint)) if (/map$/i.test(key)) paint[key] = null;
      Object.assign(paint, { wireframe: true, transparent: true, opacity: 0.4, alphaTest: 0, vertexColors: false });
      paint.color.setHex(0);
      paint.emissive.setHex(WIRES[state.look] ?? WIRES.other);
      paint.emissiveIntensity = 1;
      lines.material = paint;
      lines.userData = { wires: true };
      Object.assign(surface.material, { polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 });
      surface.material.needsUpdate = true;
      surface.parent.add(lines);
    }
    scene.queueRender?.();
  }

  function place(viewer, orbit, target, field) {
    viewer.cameraOrbit = orbit;
    viewer.cameraTarget = target;
    viewer.fieldOfView = field;
    viewer.jumpCameraToGoal?.();
  }

  function copyCamera(from, to) {
    const orbit = from.getCameraOrbit(), target = from.getCameraTarget();
    place(to, `${orbit.theta}rad ${orbit.phi}rad ${orbit.radius}m`,
      `${target.x}m ${target.y}m ${target.z}m`, `${from.getFieldOfView()}deg`);
  }

  async function startViewers() {
    const script = document.createElement("script");
    script.textContent = await text("viewer.js");
    document.head.append(script);
    await customElements.whenDefined("model-viewer");
    for (const pane of panes) {
      const viewer = document.createElement("model-viewer");
      const settings = {
        "camera-controls": "", "interaction-prompt": "none", "touch-action": "pan-y", "shadow-intensity": "0",
        "camera-orbit": ORBIT, "camera-target": "0m 0m 0m", "field-of-view": FIELD, "interpolation-decay": "60",
        "min-camera-orbit": "auto 0deg 0.4m", "max-camera-orbit": "auto 180deg 24m", "max-field-of-view": "45deg",
        loading: "eager", "disable-tap": "",
      };
      for (const [name, value] of Object.entries(settings)) viewer.setAttribute(name, value);
      pane.viewer = viewer;
    }
    for (const [pane, other] of [panes, [...panes].reverse()]) {
      pane.viewer.addEventListener("camera-change", (event) => {
        if (event.detail.source === "user-interaction") copyCamera(pane.viewer, other.viewer);
      });
      pane.viewer.addEventListener("load", () => {
        drawWires(pane.viewer);
        pane.still.hidden = true;
        pane.root.dataset.loaded = pane.viewer.dataset.wanted;
        if (other.viewer.loaded) copyCamera(other.viewer, pane.viewer);
      });
      pane.viewer.addEventListener("error", (event) => trouble(event.detail));
      pane.stage.append(pane.viewer);
    }
    byId("tools").hidden = false;
  }

  function trouble(detail) {
    const reason = detail?.sourceError?.message ?? detail?.message ?? detail?.type ?? "unknown reason";
    byId("trouble").textContent = `No 3-D view (${reason}); the pictures show the same.`;
    byId("trouble").hidden = false;
  }

  // --- what follows the slider

  function words(level) {
    const lod = levels[level];
    const standIn = shown.standIns[level];
    const share = (100 * lod.triangles) / Math.max(levels[0].triangles, 1);
    const part = level ? ` (${Number(share.toPrecision(3))} %)` : "";
    const first = `${count(lod.triangles)} triangles${part}`;
    const second = standIn ? `shown with ${count(standIn)}`
      : lod.error && level ? `error ${Number(lod.error.mean.toPrecision(2))} % mean, ${Number(lod.error.max.toPrecision(2))} % max` : "";
    return [level ? `LOD${level}` : "Source", first, second];
  }

  async function show() {
    for (const pane of panes) {
      const level = pane.level();
      const [title, ...lines] = words(level);
      const bold = document.createElement("b");
      bold.textContent = title;
      pane.caption.replaceChildren(bold, ...lines.filter(Boolean).map((line, row) => {
        const span = document.createElement("span");
        span.textContent = line;
        span.className = row ? "more" : "";
        return span;
      }));
      const picture = document.querySelector(`.pictures figure[data-kind=shaded][data-view="0"][data-level="${level}"] img`);
      if (picture) {
        const copy = picture.cloneNode();
        copy.loading = "eager";
        pane.still.replaceChildren(copy);
      }
      if (!pane.viewer) continue;
      const look = lookOf(pane);
      const layer = layerNamed(look);
      const known = (layer ? layer.models : shown.models)[level];
      pane.viewer.hidden = !known;
      if (!known) pane.still.hidden = false;
      const wanted = `${look} ${level}`;
      if (!known || pane.viewer.dataset.wanted === wanted) continue;
      pane.viewer.dataset.wanted = wanted;
      pane.viewer.alt = `${asset}, ${title}, ${lines[0]}, ${look}`;
      const url = await source(wanted);
      if (pane.viewer.dataset.wanted === wanted) pane.viewer.src = url;
    }
  }

  function choose(level) {
    state.level = level;
    if (slider) {
      slider.value = level;
      slider.setAttribute("aria-valuetext", words(level).slice(0, 2).join(", "));
    }
    for (const row of all("#levels tr[data-level]")) row.classList.toggle("chosen", Number(row.dataset.level) === level);
    choosePictures();
    drawLayouts();
    show().catch(trouble);
  }

  function choosePictures() {
    for (const figure of all(".pictures figure")) {
      const { level, view, kind } = figure.dataset;
      const right = Number(level) === state.level || (level === "0" && kind === "shaded");
      figure.hidden = !(right && Number(view) === state.view);
    }
  }

  // --- UV layouts, drawn from the models

  const COLUMNS = { SCALAR: 1, VEC2: 2 };
  const ARRAYS = { 5121: Uint8Array, 5123: Uint16Array, 5125: Uint32Array, 5126: Float32Array };

  async function array(gltf, index) {
    const accessor = gltf.accessors[index], view = gltf.bufferViews[accessor.bufferView];
    const kind = ARRAYS[accessor.componentType], columns = COLUMNS[accessor.type];
    const data = await buffer(gltf.buffers[view.buffer].uri);
    const start = (view.byteOffset ?? 0) + (accessor.byteOffset ?? 0);
    return new kind(data, start, accessor.count * columns);
  }

  const hasUv = (primitive) => (primitive.mode ?? 4) === 4 && "TEXCOORD_0" in primitive.attributes && "indices" in primitive;

  function primitivesOf(gltf, material) {
    return gltf.meshes.flatMap((mesh) => mesh.primitives)
      .filter((one) => hasUv(one) && (one.material ?? -1) === material);
  }

  // the row that a material of the source has in a level, which may have materials of its own
  function rowIn(gltf, material, name) {
    const named = (gltf.materials ?? []).findIndex((one) => name && one.name === name);
    return named >= 0 ? named : Math.min(material, (gltf.materials ?? []).length - 1);
  }

  // everything is awaited before the first stroke: what was asked for last is then what is seen
  async function layout(canvas, level, chosen) {
    const gltf = await tree(shown.models[level]);
    const name = (await tree(shown.models[0])).materials?.[chosen]?.name;
    const material = level ? rowIn(gltf, chosen, name) : chosen;
    const slot = gltf.materials?.[material]?.pbrMetallicRoughness?.baseColorTexture;
    const texture = slot && gltf.textures[slot.index];
    const image = texture && (texture.source ?? texture.extensions?.EXT_texture_webp?.source);
    const picture = new Image();
    if (image !== undefined) {
      picture.src = await address(gltf.images[image].uri);
      await picture.decode();
    }
    const parts = await Promise.all(primitivesOf(gltf, material).map(async (primitive) =>
      [await array(gltf, primitive.attributes.TEXCOORD_0), await array(gltf, primitive.indices)]));

    const pen = canvas.getContext("2d"), size = canvas.width;
    pen.clearRect(0, 0, size, size);
    if (image !== undefined) {
      pen.globalAlpha = 0.45;
      pen.drawImage(picture, 0, 0, size, size);
      pen.globalAlpha = 1;
    }
    let triangles = 0, outside = 0;
    pen.strokeStyle = getComputedStyle(document.documentElement).getPropertyValue("--accent");
    pen.lineWidth = 1;
    for (const [uv, corners] of parts) {
      for (let first = 0; first < corners.length; first += 3) {
        if (first % 6000 === 0) {
          pen.stroke();
          pen.beginPath();
        }
        const [a, b, c] = corners.subarray(first, first + 3);
        // a triangle in another repetition of the texture is drawn where it looks things up
        const left = Math.floor((uv[2 * a] + uv[2 * b] + uv[2 * c]) / 3);
        const top = Math.floor((uv[2 * a + 1] + uv[2 * b + 1] + uv[2 * c + 1]) / 3);
        outside += left !== 0 || top !== 0;
        pen.moveTo((uv[2 * a] - left) * size, (uv[2 * a + 1] - top) * size);
        for (const corner of [b, c, a]) pen.lineTo((uv[2 * corner] - left) * size, (uv[2 * corner + 1] - top) * size);
        triangles++;
      }
      pen.stroke();
    }
    const about = `UV layout of ${level ? `level ${level}` : "the source"}: ${count(triangles)} triangles`;
    canvas.setAttribute("aria-label", about);
    return outside;
  }

  async function drawLayouts() {
    if (byId("uv").hidden) return;
    const material = Number(byId("uv-material").value), level = state.level;
    const there = level in shown.models;
    const outside = await layout(byId("uv-source"), 0, material);
    if (there && level === state.level) await layout(byId("uv-level"), level, material);
    if (level !== state.level) return;
    byId("uv-level").hidden = !there;
    byId("uv-about").textContent = `Left the source, right LOD${level}.`
      + (outside ? ` ${count(outside)} triangles of the source lie outside of 0…1 (a repeated texture).` : "");
  }

  async function startLayouts() {
    if (!(0 in shown.models)) return;
    const gltf = await tree(shown.models[0]);
    const found = new Set(gltf.meshes.flatMap((mesh) => mesh.primitives).filter(hasUv).map((one) => one.material ?? -1));
    for (const material of [...found].sort((a, b) => a - b)) {
      const name = gltf.materials?.[material]?.name || (material < 0 ? "default" : `material ${material}`);
      byId("uv-material").append(new Option(name, material));
    }
    byId("uv").hidden = found.size === 0;
    byId("uv-material").addEventListener("change", drawLayouts);
  }

  // --- start

  function can3d() {
    if (!elements.has("viewer.js") || Object.keys(shown.models).length === 0) return false;
    if (typeof DecompressionStream === "undefined") return trouble({ message: "the browser is too old" });
    const canvas = document.createElement("canvas");
    if (!canvas.getContext("webgl2")) return trouble({ message: "the browser has no WebGL" });
    return true;
  }

  slider?.addEventListener("input", () => choose(Number(slider.value)));
  for (const button of all(".pick")) button.addEventListener("click", () => choose(Number(button.dataset.level)));
  for (const input of all("input[name=view]")) {
    input.addEventListener("change", () => {
      state.view = Number(input.value);
      choosePictures();
    });
  }
  for (const input of all("input[name=look]")) {
    input.addEventListener("change", () => {
      state.look = input.value;
      for (const legend of all(".legend")) legend.hidden = legend.dataset.layer !== state.look;
      show().catch(trouble);
    });
  }
  byId("wire").addEventListener("change", (event) => {
    state.wires = event.target.checked;
    for (const pane of panes) if (pane.viewer) drawWires(pane.viewer);
  });
  byId("reset").addEventListener("click", () => {
    for (const pane of panes) place(pane.viewer, ORBIT, "0m 0m 0m", FIELD);
  });
  if (navigator.clipboard && byId("copy")) {
    byId("copy").hidden = false;
    byId("copy").addEventListener("click", async () => {
      await navigator.clipboard.writeText(byId("command").textContent);
      byId("copy").textContent = "Copied";
    });
  }
  if (byId("views")) byId("views").hidden = false;

  async function start() {
    choose(state.level);
    if (can3d()) {
      await startViewers();
      await show();
    }
    if (typeof DecompressionStream !== "undefined") {
      await startLayouts();
      await drawLayouts();
    }
  }
  start().catch(trouble);
})();
