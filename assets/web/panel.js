// The list of objects and what is done with them. Names are text, never markup.

class Panel {
  constructor(scene, viewer) {
    this.scene = scene;
    this.viewer = viewer;
    this.current = 0; // selected object, 0 = none
    this.alone = null; // the only object that is shown
    this.rows = scene.objects.map((object, index) => this.makeRow(object, index));
    const list = byId("list");
    list.append(...this.rows.filter((row, index) => index > 0 || scene.objects[0].count > 0));
    list.addEventListener("keydown", (event) => this.walk(event));
    byId("title").textContent = scene.title;
    const n = scene.objects.length - 1;
    byId("count").textContent = `${count(n, "object")}, ${count(scene.count, "splat")}`;
    byId("search").addEventListener("input", () => this.filter());
    byId("search").addEventListener("keydown", (event) => {
      if (event.key === "ArrowDown") this.shownRows()[0]?.querySelector(".name").focus();
    });
    byId("all").onclick = () => this.showAll();
    byId("clear").onclick = () => this.select(0);
    byId("alone").onclick = () => this.isolate(this.current);
    byId("hide").onclick = () => this.toggle(this.current);
    byId("go").onclick = () => this.goTo(this.current);
    byId("fold").onclick = () => this.fold();
    this.fit();
    addEventListener("resize", () => this.fit());
    this.filter();
  }

  makeRow(object, index) {
    const row = byId("row").content.firstElementChild.cloneNode(true);
    const [name, alone, eye] = row.querySelectorAll("button");
    row.dataset.id = object.id;
    row.querySelector("b").textContent = object.name;
    row.querySelector(".what span").textContent = count(object.count, "splat");
    row.querySelector("i").style.background = colorText(object.color);
    const picture = row.querySelector("img");
    if (object.picture) picture.src = object.picture;
    else picture.remove();
    name.onclick = () => (index === 0 ? null : this.select(this.current === index ? 0 : index));
    name.ondblclick = () => this.goTo(index);
    alone.onclick = () => this.isolate(index);
    eye.onclick = () => this.toggle(index);
    for (const [button, verb] of [[alone, "Show alone"], [eye, "Hide"]]) {
      button.setAttribute("aria-label", `${verb}: ${object.name}`);
      button.title = verb;
    }
    row.onpointerenter = () => this.viewer.hover(index);
    row.onpointerleave = () => this.viewer.hover(0);
    return row;
  }

  // --- what is done

  select(index) {
    const { viewer, scene } = this;
    if (index === this.current) return;
    this.current = index;
    viewer.selected.fill(0);
    if (index > 0) viewer.selected[index] = 1;
    viewer.applyState();
    this.say(index > 0 ? `Selected: ${scene.objects[index].name}` : "Nothing is selected");
    this.update();
    if (index > 0) this.rows[index].scrollIntoView({ block: "nearest" });
  }

  toggle(index) {
    const { viewer, scene } = this;
    viewer.hidden[index] ^= 1;
    this.alone = null;
    viewer.applyState();
    this.say(`${viewer.hidden[index] ? "Hidden" : "Shown"}: ${scene.objects[index].name}`);
    this.update();
  }

  isolate(index) {
    if (this.alone === index) {
      this.showAll();
      return;
    }
    this.alone = index;
    this.viewer.hidden.fill(1);
    this.viewer.hidden[index] = 0;
    this.viewer.applyState();
    this.say(`Shown alone: ${this.scene.objects[index].name}`);
    this.update();
  }

  showAll() {
    this.alone = null;
    this.viewer.hidden.fill(0);
    this.viewer.applyState();
    this.say("All is shown");
    this.update();
  }

  goTo(index) {
    const { centre, radius } = this.scene.objects[index];
    this.viewer.rig.focus(centre, radius);
    this.viewer.moved();
  }

  // --- what is shown

  update() {
    const { viewer, scene, current } = this;
    this.rows.forEach((row, index) => {
      const [name, alone, eye] = row.querySelectorAll("button");
      row.classList.toggle("selected", index === current && index > 0);
      row.classList.toggle("off", viewer.hidden[index] === 1);
      press(name, index === current && index > 0);
      press(alone, this.alone === index);
      press(eye, viewer.hidden[index] === 1);
    });
    byId("all").disabled = !viewer.hidden.some(Boolean);
    byId("card").hidden = current === 0;
    if (current === 0) return;
    const object = scene.objects[current];
    byId("card-name").textContent = object.name;
    byId("card-count").textContent = count(object.count, "splat");
    byId("card-picture").hidden = !object.picture;
    if (object.picture) byId("card-picture").src = object.picture;
    press(byId("alone"), this.alone === current);
    press(byId("hide"), viewer.hidden[current] === 1);
    this.enter(this.rows[current]);
  }

  filter() {
    const words = plain(byId("search").value).split(/\s+/).filter(Boolean);
    let n = 0;
    this.rows.forEach((row, index) => {
      const name = plain(this.scene.objects[index].name);
      row.hidden = !words.every((word) => name.includes(word));
      n += row.hidden || !row.isConnected ? 0 : 1;
    });
    byId("none").hidden = n > 0;
    this.enter(this.shownRows()[0]);
  }

  say(text) {
    byId("status").textContent = text;
  }

  // --- keys: one row is reached by Tab, the others by arrows

  shownRows() {
    return this.rows.filter((row) => row.isConnected && !row.hidden);
  }

  enter(row) {
    for (const button of this.entered?.querySelectorAll("button") ?? []) button.tabIndex = -1;
    this.entered = row;
    for (const button of row?.querySelectorAll("button") ?? []) button.tabIndex = 0;
  }

  walk(event) {
    const steps = { ArrowDown: 1, ArrowUp: -1, PageDown: 8, PageUp: -8, Home: -Infinity, End: Infinity };
    const step = steps[event.key];
    if (step === undefined) return;
    event.preventDefault();
    event.stopPropagation();
    const rows = this.shownRows();
    const at = rows.indexOf(event.target.closest("li")) + step;
    const row = rows[Math.min(Math.max(at, 0), rows.length - 1)];
    this.enter(row);
    row.querySelector(`.${event.target.className}`).focus();
  }

  // --- the sheet of a phone

  fold() {
    const isOpen = byId("panel").classList.toggle("open");
    byId("fold").setAttribute("aria-expanded", isOpen);
    if (isOpen) this.entered?.scrollIntoView({ block: "nearest" });
  }

  /** On a wide page the list is always there, and its title is no button. */
  fit() {
    const isPhone = matchMedia("(max-width: 700px)").matches;
    byId("fold").disabled = !isPhone;
    byId("fold").setAttribute("aria-expanded", !isPhone || byId("panel").classList.contains("open"));
  }
}

const byId = (id) => document.getElementById(id);
const press = (button, on) => button.setAttribute("aria-pressed", on);
const plain = (text) => text.normalize("NFKD").replace(/\p{M}/gu, "").toLowerCase();
const colorText = (color) => `rgb(${color.map((part) => Math.round(255 * part)).join(" ")})`;
const count = (n, what) => `${n.toLocaleString("en")} ${what}${n === 1 ? "" : "s"}`;
