// Puts the page together: data, picture, list, views.

function fail(error) {
  const status = byId("status");
  status.className = "failure";
  status.textContent = error instanceof PageError ? error.message : `The page is damaged (${error.message}). Export it again.`;
}

/** Nothing is wrong, and nothing is loaded any more. */
function rest() {
  byId("status").className = "quiet";
  byId("status").textContent = "";
}

async function start() {
  if (typeof DecompressionStream === "undefined") {
    throw new PageError("This browser is too old for this page. Open it in a newer one.");
  }
  const scene = JSON.parse(takeText("scene"));
  const splats = await decodeSplats(scene.splats);
  const canvas = byId("picture");
  const viewer = new Viewer(canvas, { ...scene, count: splats.n }, splats);
  canvas.addEventListener("webglcontextlost", (event) => {
    event.preventDefault(); // it may come back
    fail(new PageError("The graphics of this device gave up. Load the page again."));
  });
  canvas.addEventListener("webglcontextrestored", () => {
    viewer.restore();
    rest();
  });
  const panel = new Panel(viewer.scene, viewer);
  new Pointers(viewer, panel);
  listenToKeys(viewer, panel, makeViews(scene, viewer));
  rest();
}

/** The bar under the picture; what its keys do. */
function makeViews(scene, viewer) {
  const jump = (shot) => {
    viewer.playing = null;
    viewer.rig.jump(CameraRig.poseOf(shot));
    viewer.moved();
  };
  const acts = {
    home: () => jump(scene.start),
    groups: () => {
      viewer.mode = viewer.mode === "color" ? "groups" : "color";
      press(byId("groups"), viewer.mode === "groups");
      viewer.invalidate();
    },
    play: scene.path && (() => viewer.play(viewer.playing === null)),
    help: () => {
      byId("keys").hidden = !byId("keys").hidden;
      byId("help").setAttribute("aria-expanded", !byId("keys").hidden);
    },
    bookmark: (key) => {
      const mark = scene.bookmarks.find((item) => item.key === key);
      return mark && (() => jump(mark.shot));
    },
  };
  for (const mark of scene.bookmarks) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = mark.name;
    button.onclick = () => jump(mark.shot);
    byId("bookmarks").append(button);
  }
  byId("home").onclick = acts.home;
  byId("groups").onclick = acts.groups;
  byId("groups").hidden = scene.objects.length < 2;
  byId("help").onclick = acts.help;
  byId("play").hidden = !scene.path;
  byId("play").onclick = acts.play;
  const showPlaying = viewer.onFrame;
  viewer.onFrame = () => {
    showPlaying();
    press(byId("play"), viewer.playing !== null);
  };
  return acts;
}

// Shaders are compiled when they are first drawn with: what a driver refuses shows up in a frame.
addEventListener("error", (event) => event.error instanceof PageError && fail(event.error));
start().catch(fail);
