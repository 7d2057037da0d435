// What the pages share. Each defines paint(order) and show(order, answer).
const stage = document.getElementById("stage");
const pen = stage.getContext("2d", {alpha: false, colorSpace: "srgb", willReadFrequently: true});
const state = document.getElementById("state");
let socket, last = null;

function resize() {
  stage.width = Math.round(innerWidth * devicePixelRatio);
  stage.height = Math.round(innerHeight * devicePixelRatio);
  if (last) paint(last);
}

function css(rgb) { return `rgb(${rgb[0]} ${rgb[1]} ${rgb[2]})`; }

function pixel(x, y) {
  const seen = pen.getImageData(Math.floor(x), Math.floor(y), 1, 1).data;
  return [seen[0], seen[1], seen[2]];
}

// Two frames: the first callback runs before the patch is drawn to the screen, the second after.
function afterPaint(act) { requestAnimationFrame(() => requestAnimationFrame(act)); }

function conditions() {
  const zoom = window.visualViewport ? visualViewport.scale : 1;
  return {width: stage.width, height: stage.height, pixelRatio: devicePixelRatio, zoom,
          fullscreen: document.fullscreenElement !== null || innerHeight >= screen.height,
          colourDepth: screen.colorDepth, hdr: matchMedia("(dynamic-range: high)").matches,
          forcedColours: matchMedia("(forced-colors: active)").matches, visible: document.visibilityState === "visible",
          agent: navigator.userAgent};
}

function warn(text) {
  const line = document.createElement("li");
  line.className = "warn";
  line.textContent = text;
  document.getElementById("warnings").append(line);
}

function connect() {
  const mine = socket = new WebSocket(`ws://${location.host}/socket${location.search}`);
  const tell = message => mine.send(JSON.stringify({...message, ...conditions()}));
  mine.onopen = () => { state.textContent = "connected"; tell({kind: "hello"}); };
  mine.onmessage = event => {
    const order = JSON.parse(event.data);
    if (order.kind === "outcome") { state.textContent = order.text; return; }
    if (order.kind === "end") {
      document.body.classList.remove("running");
      state.textContent = "the program has ended; the page can be closed";
      last = null; pen.fillStyle = "#000"; pen.fillRect(0, 0, stage.width, stage.height);
      mine.over = true;
      return;
    }
    document.body.classList.add("running");
    if (order.kind !== "rest") last = order;
    show(order, facts => tell({kind: "shown", sequence: order.sequence, ...facts}));
  };
  mine.onclose = () => { if (mine.over) return; state.textContent = "not connected; trying again"; setTimeout(connect, 1000); };
}

// A light box goes dark by the key O at any time, by the button while no picture stands on the screen.
function lightsOff() { if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify({kind: "lights_off"})); }
document.getElementById("dark").onclick = lightsOff;
addEventListener("keydown", event => {
  if (event.code === "KeyO" && !event.repeat && !event.ctrlKey && !event.metaKey && !event.altKey) lightsOff();
});

document.getElementById("go").onclick = async () => {
  try { await document.documentElement.requestFullscreen({navigationUI: "hide"}); }
  catch (refused) { warn("Full screen was refused; press F11."); }
  if (navigator.wakeLock) navigator.wakeLock.request("screen").catch(() => warn("The screen may fall asleep; raise its delay."));
  if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify({kind: "ready", ...conditions()}));
};
if (devicePixelRatio !== Math.round(devicePixelRatio)) warn("The page or the desktop is zoomed; set both to 100 %.");
if (matchMedia("(forced-colors: active)").matches) warn("High-contrast colours are on; switch them off.");
if (matchMedia("(dynamic-range: high)").matches) warn("The screen runs in HDR; its levels are then mapped: switch HDR off.");
addEventListener("resize", resize);
resize();
connect();
