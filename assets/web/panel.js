// The list of objects and what is done with them. Names are text, never markup.

class Panel {
  constructor(scene, viewer) {
    this.scene = scene;
    this.viewer = viewer;
    this.current = 0; // selected object, 0 = none
    this.alone = null; // the line that alone is shown
    this.lines = linesOf(scene.objects); // from top to bottom: objects, and heads that fold
    this.lineOf = []; // by object
    for (const line of this.lines) {
      line.row = this.makeRow(line);
      if (line.index >= 0) this.lineOf[line.index] = line;
    }
    const list = byId("list");
    list.append(...this.lines.map((line) => line.row));
    list.addEventListener("keydown", (event) => this.walk(event));
    byId("title").textContent = scene.title;
    const n = scene.objects.length - 1;
    byId("count").textContent = `${count(n, "object")}, ${count(scene.count, "splat")}`;
    byId("search").addEventListener("input", () => this.filter());
    byId("search").addEventListener("keydown", (event) => {
      if (event.key !== "ArrowDown") return;
      const found = this.lines.find((line) => line.index >= 0 && !line.row.hidden);
      if (!found) return;
      this.enter(found.row);
      found.row.querySelector(".name").focus();
    });
    byId("all").onclick = () => this.showAll();
    byId("clear").onclick = () => this.select(0);
    byId("alone").onclick = () => this.isolate(this.lineOf[this.current]);
    byId("hide").onclick = () => this.toggle(this.lineOf[this.current]);
    byId("go").onclick = () => this.goTo(this.current);
    byId("fold").onclick = () => this.fold();
    this.fit();
    addEventListener("resize", () => this.fit());
    this.filter();
  }

  makeRow(line) {
    const { index } = line, object = this.scene.objects[index];
    const row = byId("row").content.firstElementChild.cloneNode(true);
    const [name, alone, eye] = row.querySelectorAll("button");
    row.querySelector("b").textContent = line.name;
    row.style.paddingInlineStart = `${line.depth}rem`;
    const picture = row.querySelector("img"), stripe = row.querySelector("i");
    if (object?.picture) picture.src = object.picture;
    else picture.remove();
    if (object) {
      row.dataset.id = object.id;
      row.querySelector(".what span").textContent = count(object.count, "splat");
      stripe.style.background = colorText(object.color);
      if (object.locked) name.append(byId("lock").content.cloneNode(true));
      name.onclick = () => (index === 0 ? null : this.select(this.current === index ? 0 : index));
      name.ondblclick = () => this.goTo(index);
      row.onpointerenter = () => this.viewer.hover(index);
      row.onpointerleave = () => this.viewer.hover(0);
    } else {
      row.classList.add("head");
      row.querySelector(".what span").textContent = count(line.members.length, "object");
      stripe.replaceWith(byId("caret").content.cloneNode(true));
      name.removeAttribute("aria-pressed");
      name.onclick = () => this.open(line, !line.isOpen);
    }
    alone.onclick = () => this.isolate(line);
    eye.onclick = () => this.toggle(line);
    for (const [button, verb] of [[alone, "Show alone"], [eye, "Hide"]]) {
      button.setAttribute("aria-label", `${verb}: ${line.name}`);
      button.title = verb;
    }
    return row;
  }

  // --- what is done

  select(index) {
    const { viewer, scene } = this;
    if (index > 0 && scene.objects[index].locked) {
      this.select(0);
      this.say(`Locked: ${scene.objects[index].name}`);
      return;
    }
    if (index === this.current) return;
    this.current = index;
    viewer.selected.fill(0);
    if (index > 0) viewer.selected[index] = 1;
    viewer.applyState();
    this.say(index > 0 ? `Selected: ${scene.objects[index].name}` : "Nothing is selected");
    if (index > 0) this.reveal(this.lineOf[index]);
    this.update();
    if (index > 0) this.lineOf[index].row.scrollIntoView({ block: "nearest" });
  }

  /** Hide all that is in a line, or show it when nothing of it is shown. */
  toggle(line) {
    const { viewer } = this, hides = !this.isHidden(line);
    for (const index of line.members) viewer.hidden[index] = hides ? 1 : 0;
    this.alone = null;
    viewer.applyState();
    this.say(`${hides ? "Hidden" : "Shown"}: ${line.name}`);
    this.update();
  }

  isolate(line) {
    if (this.alone === line) {
      this.showAll();
      return;
    }
    this.alone = line;
    this.viewer.hidden.fill(1);
    for (const index of line.members) this.viewer.hidden[index] = 0;
    this.viewer.applyState();
    this.say(`Shown alone: ${line.name}`);
    this.update();
  }

  isHidden(line) {
    return line.members.every((index) => this.viewer.hidden[index] === 1);
  }

  showAll() {
    this.alone = null;
    this.viewer.hidden.fill(0);
    this.viewer.applyState();
    this.say("All is shown");
    this.update();
  }

  /** Open or close a head. */
  open(line, isOpen) {
    line.isOpen = isOpen;
    this.filter(line.row);
  }

  /** Open the folders that a line lies in; the background stays as it is. */
  reveal(line) {
    if (!line.within || this.words().length > 0) return;
    for (let head = line.within; head; head = head.within) head.isOpen ||= head.isFolder;
    this.filter(line.row);
  }

  goTo(index) {
    const { centre, radius } = this.scene.objects[index];
    this.viewer.rig.focus(centre, radius);
    this.viewer.moved();
  }

  // --- what is shown

  update() {
    const { viewer, scene, current } = this;
    for (const line of this.lines) {
      const [name, alone, eye] = line.row.querySelectorAll("button");
      const isChosen = line.index === current && current > 0, isHidden = this.isHidden(line);
      line.row.classList.toggle("selected", isChosen);
      line.row.classList.toggle("off", isHidden);
      if (line.index >= 0) press(name, isChosen);
      press(alone, this.alone === line);
      press(eye, isHidden);
    }
    byId("all").disabled = !viewer.hidden.some(Boolean);
    byId("card").hidden = current === 0;
    if (current === 0) return;
    const object = scene.objects[current], line = this.lineOf[current];
    byId("card-name").textContent = object.name;
    byId("card-count").textContent = count(object.count, "splat");
    byId("card-picture").hidden = !object.picture;
    if (object.picture) byId("card-picture").src = object.picture;
    press(byId("alone"), this.alone === line);
    press(byId("hide"), this.isHidden(line));
    this.enter(line.row);
  }

  words() {
    return plain(byId("search").value).split(/\s+/).filter(Boolean);
  }

  /** Show the rows that are searched for; without a search, those whose heads are open. */
  filter(entered) {
    const words = this.words();
    const isFound = (index) => {
      const name = plain(this.scene.objects[index].name);
      return words.every((word) => name.includes(word));
    };
    let n = 0;
    for (const line of this.lines) {
      const isHead = line.index < 0;
      const isOpen = words.length > 0 || line.isOpen;
      if (isHead) line.row.querySelector(".name").setAttribute("aria-expanded", isOpen);
      if (words.length > 0) line.row.hidden = !(isHead ? line.members.some(isFound) : isFound(line.index));
      else line.row.hidden = Boolean(line.within && (line.within.row.hidden || !line.within.isOpen));
      n += line.row.hidden ? 0 : 1;
    }
    byId("none").hidden = n > 0;
    this.enter(entered ?? this.shownRows()[0]);
  }

  say(text) {
    byId("status").textContent = text;
  }

  // --- keys: one row is reached by Tab, the others by arrows

  shownRows() {
    return this.lines.map((line) => line.row).filter((row) => !row.hidden);
  }

  enter(row) {
    for (const button of this.entered?.querySelectorAll("button") ?? []) button.tabIndex = -1;
    if (row?.hidden) row = this.shownRows()[0]; // in a fold that is closed
    this.entered = row;
    for (const button of row?.querySelectorAll("button") ?? []) button.tabIndex = 0;
  }

  walk(event) {
    const steps = { ArrowDown: 1, ArrowUp: -1, PageDown: 8, PageUp: -8, Home: -Infinity, End: Infinity };
    const step = steps[event.key];
    const line = this.lines.find((one) => one.row === event.target.closest("li"));
    if (line?.index < 0 && (event.key === "ArrowRight" || event.key === "ArrowLeft")) {
      event.stopPropagation();
      this.open(line, event.key === "ArrowRight");
    }
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

/**
 * Lines of the list: folders by name, then objects, each with those that lie under it; the background
 * in a fold, and what is in no object, last. `members` are the objects that a line acts on, `within` is
 * the head that must be open to see it.
 */
function linesOf(objects) {
  const lines = [], under = new Map(), folders = new Map();
  const isTop = ({ folder, parent }) => !folder && !parent;
  const hasOthers = objects.some((object, index) => index > 0 && !object.background);
  // What others lie under is listed: they would be in a fold that is closed.
  const isBehind = (index) => objects[index].background && isTop(objects[index]) && hasOthers && !under.has(index);
  objects.forEach(({ parent }, index) => parent > 0 && under.set(parent, [...(under.get(parent) ?? []), index]));
  const tree = (index) => [index, ...(under.get(index) ?? []).flatMap(tree)];
  const add = (index, depth, within) => {
    lines.push({ index, name: objects[index].name, depth, within, members: tree(index) });
    for (const child of under.get(index) ?? []) add(child, depth + 1, within);
  };
  const head = (name, depth, within, members, isFolder) => {
    const line = { index: -1, name, depth, within, members, isFolder, isOpen: isFolder };
    lines.push(line);
    return line;
  };
  objects.forEach(({ folder, parent }, index) => {
    if (index === 0 || parent > 0) return;
    const names = folder ? folder.split("/") : [];
    for (let n = 0; n <= names.length; n++) {
      const path = names.slice(0, n).join("/");
      if (!folders.has(path)) folders.set(path, { inner: new Set(), own: [] });
      if (n < names.length) folders.get(path).inner.add(names.slice(0, n + 1).join("/"));
    }
    if (!isBehind(index)) folders.get(folder).own.push(index);
  });
  const inside = (path) => {
    const { inner, own } = folders.get(path);
    return [...[...inner].flatMap(inside), ...own.flatMap(tree)];
  };
  const order = new Intl.Collator(undefined, { numeric: true, sensitivity: "base" });
  const fill = (path, depth, within) => {
    const { inner, own } = folders.get(path);
    for (const next of [...inner].sort(order.compare)) {
      fill(next, depth + 1, head(next.split("/").pop(), depth, within, inside(next), true));
    }
    for (const index of own) add(index, depth, within);
  };
  if (folders.has("")) fill("", 0, null);
  const behind = objects.flatMap((object, index) => (index > 0 && isBehind(index) ? [index] : []));
  if (behind.length > 0) {
    const fold = head("Background and supports", 0, null, behind, false);
    for (const index of behind) add(index, 0, fold);
  }
  if (objects[0].count > 0) add(0, 0, null);
  return lines;
}

const byId = (id) => document.getElementById(id);
const press = (button, on) => button.setAttribute("aria-pressed", on);
const plain = (text) => text.normalize("NFKD").replace(/\p{M}/gu, "").toLowerCase();
const colorText = (color) => `rgb(${color.map((part) => Math.round(255 * part)).join(" ")})`;
const count = (n, what) => `${n.toLocaleString("en")} ${what}${n === 1 ? "" : "s"}`;
