// Starts the viewer of a report when it comes into view: unpacks three.js and the models that the page carries.
(() => {
  const place = document.getElementById("viewer"), form = place.querySelector("form"), stage = place.querySelector(".stage");
  const message = place.querySelector(".message"), data = () => JSON.parse(place.querySelector("script").textContent);
  const asked = new URLSearchParams(location.hash.slice(1)); // e.g. #model=1&shown=wireframe
  const WORDS = { base_color: "base colour" };
  const say = (text, state) => { message.textContent = text; message.hidden = !text; place.dataset.state = state; };

  async function unpacked(text) {
    const packed = new Blob([Uint8Array.from(atob(text), (c) => c.charCodeAt(0))]);
    return new Uint8Array(await new Response(packed.stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer());
  }

  // A page opened from a disk may not load modules from files; they come from data: addresses by an import map.
  async function modules(packed) {
    const imports = {};
    for (const [name, text] of Object.entries(packed)) {
      const source = new TextDecoder().decode(await unpacked(text));
      imports[name] = `data:text/javascript;charset=utf-8,${encodeURIComponent(source)}`;
    }
    const map = document.createElement("script");
    map.type = "importmap";
    map.textContent = JSON.stringify({ imports });
    document.head.append(map);
    return import("viewer");
  }

  async function start() {
    say("Unpacking …", "unpacking");
    if (!document.createElement("canvas").getContext("webgl2")) {
      return say("This browser has no WebGL 2, which the model needs; all else on this page does not.", "none");
    }
    const { modules: packed, models } = data(), { Viewer, readModel } = await modules(packed);
    const canvas = place.querySelector("canvas"), viewer = new Viewer(canvas, { background: 0x2b3036 }), read = [];
    let shown = asked.get("shown");
    for (const [k, model] of models.entries()) form.model.add(new Option(model.label, k));
    form.model.value = asked.get("model") ?? 0;
    form.model.hidden = models.length < 2;

    const choices = (model) => {
      const names = Object.keys(model.materials);
      shown = names.includes(shown) ? shown : names[0];
      form.querySelector(".choices").replaceChildren(...names.map((name) => {
        const label = document.createElement("label"), input = document.createElement("input");
        Object.assign(input, { type: "radio", name: "shown", value: name, checked: name === shown });
        label.append(input, WORDS[name] || name);
        return label;
      }));
    };
    const apply = async () => {
      const k = Number(form.model.value), fresh = !read[k];
      const model = (read[k] ??= await readModel(await unpacked(models[k].glb)));
      if (fresh || form.dataset.model !== form.model.value) choices(model);
      form.dataset.model = form.model.value;
      shown = form.querySelector("[name=shown]:checked").value;
      for (const name of ["turn", "exposure"]) form[name].parentNode.hidden = shown !== "shaded";
      form.behind.parentNode.hidden = !model.light;
      place.querySelector(".caption").textContent = models[k].caption;
      viewer.show(model, { light: model.light, shown, turn: Number(form.turn.value), exposure: Number(form.exposure.value), behind: form.behind.checked });
    };
    const safely = () => apply().catch(fail);
    form.addEventListener("input", safely);
    form.addEventListener("submit", (event) => event.preventDefault());
    viewer.controls.enableZoom = false; // else the wheel would stop the page from scrolling
    canvas.addEventListener("pointerdown", () => { viewer.controls.enableZoom = true; });
    canvas.addEventListener("pointerleave", () => { viewer.controls.enableZoom = false; });
    await apply();
    new ResizeObserver(() => viewer.resize(stage.clientWidth, stage.clientHeight)).observe(stage);
    viewer.resize(stage.clientWidth, stage.clientHeight);
    place.dataset.ready = "";
    viewer.run(() => say("", "shown"));
  }

  const fail = (error) => say(`The model cannot be shown: ${error.message || error}`, "failed");
  say("The model comes when this is in view.", "waiting");
  const seen = new IntersectionObserver((entries) => {
    if (!entries.some((entry) => entry.isIntersecting)) return;
    seen.disconnect();
    start().catch(fail);
  });
  seen.observe(stage);
})();
