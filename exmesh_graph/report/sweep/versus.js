// Two variants of a sweep, or one and the truth, on both sides of a line that is dragged; their error maps beside.
(() => {
  const place = document.getElementById("versus"), form = place.querySelector("form");
  const { gap, variants, strips, pictures } = JSON.parse(place.querySelector("script").textContent);
  const asked = new URLSearchParams(location.hash.slice(1)); // e.g. #picture=1&left=2&right=0&line=30
  const [main, mine, theirs] = place.querySelectorAll("figure"), [under, over] = main.querySelectorAll(".panel");
  const slider = main.querySelector("input");

  // Panel `index` of a strip, of which all have the same height; `picture` as in the data.
  function part(element, picture, variant, index) {
    const [width] = picture.size, { panels } = picture;
    element.style.backgroundImage = `url(${strips[picture.strips[variant]]})`;
    element.style.backgroundSize = `${(100 * (panels * width + (panels - 1) * gap)) / width}% 100%`;
    element.style.backgroundPosition = `${(100 * index) / (panels - 1)}% 0`;
  }

  function errors(figure, picture, variant) {
    figure.hidden = variant === "" || picture.panels < 3;
    if (figure.hidden) return;
    part(figure.querySelector(".panel"), picture, variant, 2);
    figure.querySelector("figcaption").innerHTML = "<strong></strong> ";
    figure.querySelector("strong").textContent = `Error of ${variants[variant]}`;
    figure.querySelector("figcaption").append(picture.captions[variant]);
  }

  function fill(select, entries, value) {
    select.replaceChildren(...entries.map(([name, text]) => new Option(text, name)));
    select.value = entries.some(([name]) => name === value) ? value : entries[0][0];
  }

  function show() {
    const picture = pictures[form.picture.value];
    const there = variants.map((name, k) => [String(k), name]).filter(([k]) => k in picture.strips);
    fill(form.left, there, form.left.value);
    fill(form.right, [["", "the truth"], ...there], form.right.value);
    const left = form.left.value, right = form.right.value;
    place.style.setProperty("--shape", picture.size.join("/"));
    part(over, picture, left, 0);
    part(under, picture, right === "" ? left : right, right === "" ? 1 : 0);
    main.querySelector("figcaption").textContent = `${variants[left]} | ${right === "" ? "the truth" : variants[right]}`;
    errors(mine, picture, left);
    errors(theirs, picture, right === left ? "" : right);
    main.querySelector(".side").style.setProperty("--cut", `${slider.value}%`);
    place.dataset.state = "shown";
  }

  fill(form.picture, pictures.map(({ title }, k) => [String(k), title]), asked.get("picture"));
  for (const name of ["left", "right"]) fill(form[name], [["", ""], ...variants.map((text, k) => [String(k), text])], asked.get(name) ?? (name === "left" ? "0" : ""));
  slider.value = asked.get("line") ?? 50;
  form.addEventListener("input", show);
  form.addEventListener("submit", (event) => event.preventDefault());
  slider.addEventListener("input", show);
  show();
})();
