// The player: a click on a segment of a take whose motion is embedded shows it. Positions lie packed in #motions.
(() => {
  const source = document.getElementById("motions"), player = document.getElementById("player");
  if (!source || !player || !window.DecompressionStream) return;
  const { joints, parents, motions } = JSON.parse(source.textContent);
  const takes = new Map(motions.map(motion => [motion.take, motion]));
  const canvas = player.querySelector("canvas"), pen = canvas.getContext("2d");
  const [what, play, time, speed, loop, close] =
    [".what", ".play", "input[type=range]", "select", ".loop", ".close"].map(name => player.querySelector(name));
  const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
  let shown = null, at = 0, from = 0, to = 0, running = false, before = 0, turn = 0.6, chosen = null;

  async function unpack(motion) {
    if (motion.rows) return motion;
    const bytes = Uint8Array.from(atob(motion.data), letter => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    const steps = new Int16Array(await new Response(stream).arrayBuffer());
    const length = steps.length / (3 * joints.length);
    motion.rows = Array.from({ length: 3 * joints.length }, (_, row) => {
      const values = new Int16Array(length);
      let sum = 0;
      for (let i = 0; i < length; i++) values[i] = sum = (sum + steps[row * length + i]) << 16 >> 16;
      return values;
    });
    motion.length = length;
    motion.data = null;
    return motion;
  }

  function place(joint, frame) {
    const left = Math.min(Math.floor(frame), shown.length - 1), right = Math.min(left + 1, shown.length - 1);
    const share = frame - left, point = [];
    for (let axis = 0; axis < 3; axis++) {
      const a = shown.rows[3 * joint + axis][left], b = shown.rows[3 * joint + axis][right];
      if (a === -32768) return null;
      point.push((b === -32768 ? a : a + (b - a) * share) * shown.unit_m);
    }
    return point;
  }

  function draw() {
    const style = getComputedStyle(document.body), ink = style.color;
    const line = getComputedStyle(document.documentElement).getPropertyValue("--line");
    const bone = getComputedStyle(document.documentElement).getPropertyValue("--accent");
    pen.clearRect(0, 0, canvas.width, canvas.height);
    const points = joints.map((_, joint) => place(joint, at * shown.rate_hz));
    const root = points.find(point => point) ?? [0, 1, 0];
    const size = canvas.height / 2.5, cos = Math.cos(turn), sin = Math.sin(turn);
    const onto = ([x, y, z]) => {
      const dx = x - root[0], dz = z - root[2];
      const depth = dz * cos - dx * sin;
      return [canvas.width / 2 + (dx * cos + dz * sin) * size, canvas.height * 0.86 - y * size - depth * size * 0.18];
    };
    pen.lineWidth = 1;
    pen.strokeStyle = line;
    const near = value => Math.round(value * 2) / 2;
    for (let i = -4; i <= 4; i++) {
      for (const [a, b] of [[[i / 2, -2], [i / 2, 2]], [[-2, i / 2], [2, i / 2]]]) {
        pen.beginPath();
        for (const [x, z] of [a, b]) pen.lineTo(...onto([near(root[0]) + x, 0, near(root[2]) + z]));
        pen.stroke();
      }
    }
    pen.lineWidth = 5;
    pen.lineCap = "round";
    parents.forEach((parent, joint) => {
      if (parent < 0 || !points[parent] || !points[joint]) return;
      pen.strokeStyle = joints[joint].startsWith("r") && joints[joint] !== "root" ? bone : ink;
      pen.beginPath();
      pen.moveTo(...onto(points[parent]));
      pen.lineTo(...onto(points[joint]));
      pen.stroke();
    });
    if (!points.some(point => point)) { pen.fillStyle = ink; pen.font = "24px sans-serif"; pen.fillText("not seen here", 20, 40); }
    time.value = at;
    what.textContent = `${shown.take}, ${at.toFixed(2)} s${chosen ? ` · ${chosen}` : ""}`;
  }

  function step(now) {
    if (!running) return;
    at += (now - before) / 1000 * speed.value;
    before = now;
    const end = loop.checked ? to : shown.length / shown.rate_hz, begin = loop.checked ? from : 0;
    if (at >= end) at = begin;
    draw();
    requestAnimationFrame(step);
  }

  function run(on) {
    running = on;
    play.textContent = on ? "pause" : "play";
    if (on) requestAnimationFrame(now => { before = now; requestAnimationFrame(step); });
  }

  async function show(block) {
    shown = await unpack(takes.get(block.closest("[data-take]").dataset.take));
    const rate = shown.rate_hz * shown.step;
    [from, to] = [block.dataset.start / rate, block.dataset.stop / rate];
    chosen = block.dataset.what ?? block.querySelector("title").textContent.split(":")[0];
    time.max = shown.length / shown.rate_hz;
    at = from;
    player.hidden = false;
    draw();
    run(!calm);
  }

  for (const figure of document.querySelectorAll("[data-take]")) {
    if (!takes.has(figure.dataset.take)) continue;
    for (const block of figure.querySelectorAll("rect[data-start]")) {
      block.setAttribute("tabindex", "0");
      block.setAttribute("role", "button");
      block.classList.add("playable");
      block.addEventListener("click", () => show(block));
      block.addEventListener("keydown", event => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); show(block); } });
    }
  }
  play.addEventListener("click", () => run(!running));
  time.addEventListener("input", () => { loop.checked = false; at = +time.value; draw(); });
  close.addEventListener("click", () => { run(false); player.hidden = true; });
  addEventListener("keydown", event => { if (event.key === "Escape") close.click(); });
  canvas.addEventListener("pointermove", event => { if (event.buttons) { turn += event.movementX / 120; draw(); } });
})();
