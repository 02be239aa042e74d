// The player shows the motion of an interval as a stick figure, beside the nearest example where the page has one.
//
// Positions lie packed in #motions (reports/embedded_motions.py). An interval is an element with data-start and
// data-stop, in analysis frames, inside of an element with data-take, or with all three; data-what is its title,
// data-near its place in the list of nearest examples. Where that shows the same moments, data-near-start is the frame
// that it begins at, and both are seen from the same side. A click plays it. A canvas with these attributes is a small
// figure that moves by itself.
// Every svg.plot of a [data-take] shows a playhead; data-left and data-width, in percent, place a take within a plot.
// data-one and data-other are the captions of an interval and of what stands beside it. Where #motions has rays, a box
// draws them: lines from the cameras to the places that they saw. Where it has clouds, points of a depth camera are drawn.
// Where it has triads, the axes of limbs are drawn as the take has them and, dashed, as sensors report them; those of the
// limb in data-limb stand out.
// The document gets the event "playhead" (detail: take, frame, seconds) at every picture, and "playend" on close.
(() => {
  const source = document.getElementById("motions"), player = document.getElementById("player");
  if (!source || !player || !window.DecompressionStream) return;
  const { joints, parents, motions, near = [], rays = [], clouds = [], triads = [] } = JSON.parse(source.textContent);
  for (const one of near) { let sum = 0; one[1] = one[1].map(step => sum += step); }
  const canvas = player.querySelector("canvas"), pen = canvas.getContext("2d"), playerPen = pen;
  const [what, now, play, time, speed, loop, close, wide] =
    [".title", ".now", ".play", "input[type=range]", "select", ".loop", ".close", ".rays"].map(name => player.querySelector(name));
  const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
  const sides = joints.map(name => name === "root" ? "middle" : { l: "left", r: "right" }[name[0]] ?? "middle");
  const [lhip, rhip] = ["lhip", "rhip"].map(name => joints.indexOf(name));
  let shown = null, at = 0, from = 0, to = 0, running = false, before = 0, turn = 0.6, playing = null;

  const rate = motion => motion.rate_hz * motion.step;
  const index = (motion, frame) => (frame - motion.first) / motion.step;
  const attribute = (block, name) => block.closest(`[data-${name}]`)?.dataset[name];

  function motionOf(block) {
    const take = attribute(block, "take"), start = +block.dataset.start, stop = +block.dataset.stop;
    const pieces = motions.filter(motion => motion.take === take);
    return pieces.find(motion => motion.first <= start && stop <= motion.first + motion.frames);
  }

  async function unpack(motion) {
    if (!motion || motion.rows) return motion;
    const count = motion.count ?? (motion.points ? motion.points.length * motion.cameras.length : joints.length);
    const bytes = Uint8Array.from(atob(motion.data), letter => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    const steps = new Int16Array(await new Response(stream).arrayBuffer());
    const length = steps.length / (3 * count);
    motion.rows = Array.from({ length: 3 * count }, (_, row) => {
      const values = new Int16Array(length);
      let sum = 0;
      for (let i = 0; i < length; i++) values[i] = sum = (sum + steps[row * length + i]) << 16 >> 16;
      return values;
    });
    motion.length = length;
    return motion;
  }

  function place(motion, joint, position) {
    const inside = Math.min(Math.max(position, 0), motion.length - 1);
    const left = Math.floor(inside), right = Math.min(left + 1, motion.length - 1), share = inside - left, point = [];
    for (let axis = 0; axis < 3; axis++) {
      const a = motion.rows[3 * joint + axis][left], b = motion.rows[3 * joint + axis][right];
      if (a === -32768) return null;
      point.push((b === -32768 ? a : a + (b - a) * share) * motion.unit_m);
    }
    return point;
  }

  function heading(motion, position) {
    const [left, right] = [lhip, rhip].map(joint => joint < 0 ? null : place(motion, joint, position));
    return left && right ? Math.atan2(left[2] - right[2], left[0] - right[0]) : null;
  }

  // The angle of view from which the body half faces the viewer.
  const front = (motion, frame) => (heading(motion, index(motion, frame)) ?? 1.2) - 0.6;

  // Draw the figure of one frame into a box [x, width] of a canvas, and return whether a joint is known there.
  function figure(pen, motion, position, view, x, width) {
    const style = getComputedStyle(document.documentElement), { height } = pen.canvas;
    const colour = name => style.getPropertyValue(`--${name}`) || getComputedStyle(document.body).color;
    const points = joints.map((_, joint) => place(motion, joint, position));
    const root = points.find(point => point) ?? [0, 1, 0];
    const seen = pen === playerPen && wide?.checked ? raysOf(motion) : null;
    const size = Math.min(height / 2.5, width / 1.9) * (seen ? 0.3 : 1), cos = Math.cos(view), sin = Math.sin(view);
    const onto = ([px, y, pz]) => {
      const dx = px - root[0], dz = pz - root[2];
      const depth = dz * cos - dx * sin;
      return [x + width / 2 + (dx * cos + dz * sin) * size, height * 0.86 - y * size + depth * size * 0.18];
    };
    const near = value => Math.round(value * 2) / 2;
    pen.save();
    pen.beginPath();
    pen.rect(x, 0, width, height);
    pen.clip();
    pen.lineWidth = 1;
    pen.strokeStyle = colour("line");
    for (let i = -4; i <= 4; i++) {
      for (const ends of [[[i / 2, -2], [i / 2, 2]], [[-2, i / 2], [2, i / 2]]]) {
        pen.beginPath();
        for (const [gx, gz] of ends) pen.lineTo(...onto([near(root[0]) + gx, 0, near(root[2]) + gz]));
        pen.stroke();
      }
    }
    if (seen) drawRays(pen, seen, motion, position, onto, colour);
    const cloud = pen === playerPen ? clouds.find(one => one.rows && one.take === motion.take) : null;
    if (cloud) drawCloud(pen, cloud, position, onto, colour);
    pen.lineWidth = size / 42;
    pen.lineCap = "round";
    for (const side of ["middle", "left", "right"]) {
      pen.strokeStyle = colour(side === "middle" ? "ink" : side);
      parents.forEach((parent, joint) => {
        if (sides[joint] !== side || parent < 0 || !points[parent] || !points[joint]) return;
        pen.beginPath();
        pen.moveTo(...onto(points[parent]));
        pen.lineTo(...onto(points[joint]));
        pen.stroke();
      });
    }
    const axes = pen === playerPen ? triads.find(one => one.rows && one.take === motion.take) : null;
    if (axes) drawTriads(pen, axes, position, onto, colour);
    pen.restore();
    return points.some(point => point);
  }

  const raysOf = motion => rays.find(one => one.rows && (one.take === motion.take || one.take === playing?.take));

  // The points of a frame have no counterparts in the next one: those of the nearest frame are drawn.
  function drawCloud(pen, cloud, position, onto, colour) {
    pen.fillStyle = colour("soft");
    for (let p = 0; p < cloud.count; p++) {
      const point = place(cloud, p, Math.round(position));
      if (!point) continue;
      const [x, y] = onto(point);
      pen.fillRect(x - 1.5, y - 1.5, 3, 3);
    }
  }

  // Seven points of each limb: its middle, the tips of the take's axes, and those of the sensor's.
  function drawTriads(pen, axes, position, onto, colour) {
    const chosen = attribute(playing.block, "limb");
    axes.limbs.forEach((limb, l) => {
      const middle = place(axes, 7 * l, position);
      if (!middle) return;
      pen.globalAlpha = chosen && chosen !== limb ? 0.25 : 1;
      for (let tip = 1; tip < 7; tip++) {
        const end = place(axes, 7 * l + tip, position);
        if (!end) continue;
        pen.strokeStyle = colour(`axis-${"xyz"[(tip - 1) % 3]}`);
        pen.lineWidth = tip < 4 ? 3 : 2.5;
        pen.setLineDash(tip < 4 ? [] : [5, 5]);
        pen.beginPath();
        pen.moveTo(...onto(middle));
        pen.lineTo(...onto(end));
        pen.stroke();
      }
    });
    pen.setLineDash([]);
    pen.globalAlpha = 1;
  }

  // A ray that passes by its joint at more than 10 cm is drawn in the colour of faults.
  function drawRays(pen, seen, motion, position, onto, colour) {
    seen.cameras.forEach(({ name, centre }, camera) => {
      const [x, y] = onto(centre);
      pen.fillStyle = pen.strokeStyle = colour("soft");
      pen.fillRect(x - 4, y - 4, 8, 8);
      pen.font = "14px sans-serif";
      pen.fillText(name, x + 7, y + 5);
      seen.points.forEach((point, p) => {
        const end = place(seen, camera * seen.points.length + p, position), joint = place(motion, joints.indexOf(point), position);
        if (!end || !joint) return;
        const away = Math.hypot(...end.map((value, axis) => value - joint[axis]));
        pen.globalAlpha = away > 0.1 ? 0.8 : 0.25;
        pen.strokeStyle = colour(away > 0.1 ? "bad" : "accent");
        pen.beginPath();
        pen.moveTo(x, y);
        pen.lineTo(...onto(end));
        pen.stroke();
      });
      pen.globalAlpha = 1;
    });
  }

  // The frame of the nearest example that belongs to a frame of the hit, along the warping path.
  function partner(block, frame, motion) {
    const [, path] = near[block.dataset.near];
    const position = Math.min(Math.max((frame - (block.dataset.nearStart ?? block.dataset.start)) / motion.step, 0), path.length - 1);
    const left = Math.floor(position), a = path[left], b = path[Math.min(left + 1, path.length - 1)];
    return a + (b >= a && b - a <= 8 ? (b - a) * (position - left) : 0);
  }

  function draw() {
    const frame = at * rate(shown), { example } = playing, half = example ? canvas.width / 2 : canvas.width;
    const write = (text, x) => { pen.fillStyle = getComputedStyle(document.body).color; pen.font = "22px sans-serif"; pen.fillText(text, x, 26); };
    pen.clearRect(0, 0, canvas.width, canvas.height);
    if (!figure(pen, shown, index(shown, frame), turn, 0, half)) write("not seen here", 20);
    if (example) {
      const other = index(example, partner(playing.block, frame, shown));
      figure(pen, example, other, turn + playing.facing, half, half);
      write(attribute(playing.block, "one") ?? "found", 12);
      write(attribute(playing.block, "other") ?? "nearest example", half + 12);
    }
    time.value = at;
    now.textContent = `${at.toFixed(2)} s`;
    document.dispatchEvent(new CustomEvent("playhead", { detail: { take: shown.take, frame, frames: shown.total, seconds: at } }));
  }

  function step(moment) {
    if (!running) return;
    at += (moment - before) / 1000 * speed.value;
    before = moment;
    const end = loop.checked ? to : +time.max, begin = loop.checked ? from : +time.min;
    if (at >= end) at = begin;
    draw();
    requestAnimationFrame(step);
  }

  function run(on) {
    running = on;
    play.textContent = on ? "pause" : "play";
    if (on) requestAnimationFrame(moment => { before = moment; requestAnimationFrame(step); });
  }

  async function show(block) {
    const found = motionOf(block);
    if (!found) return;
    const chosen = await unpack(found);
    const example = block.dataset.near ? await unpack(motions[near[block.dataset.near][0]]) : null;
    playing?.block.classList.remove("playing");
    if (shown && shown.take !== chosen.take) document.dispatchEvent(new CustomEvent("playend"));
    shown = chosen;
    [from, to] = [block.dataset.start / rate(shown), block.dataset.stop / rate(shown)];
    playing = { block, example, facing: 0, take: chosen.take };
    const seen = await unpack(rays.find(one => one.take === chosen.take));
    if (wide) wide.parentElement.hidden = !seen;
    await unpack(clouds.find(one => one.take === chosen.take));
    await unpack(triads.find(one => one.take === chosen.take));
    if (example && !block.dataset.nearStart) {
      const [one, other] = [heading(example, index(example, partner(block, +block.dataset.start, shown))), heading(shown, index(shown, +block.dataset.start))];
      if (one !== null && other !== null) playing.facing = one - other;
    }
    turn = front(shown, +block.dataset.start);
    block.classList.add("playing");
    const title = block.dataset.what ?? block.querySelector("title")?.textContent.split(":")[0] ?? "";
    what.textContent = `${shown.take} · ${title}${example ? ` · beside it ${example.take}` : ""}`;
    [time.min, time.max] = [shown.first / rate(shown), (shown.first + shown.length * shown.step) / rate(shown)];
    at = from;
    player.hidden = false;
    draw();
    run(!calm);
  }

  // Playheads: a line in every plot of the take.
  function plots(take) {
    const found = [];
    for (const box of document.querySelectorAll(`[data-take="${CSS.escape(take)}"]`)) {
      const inside = box.ownerSVGElement ? [box.ownerSVGElement] : box.querySelectorAll("svg.plot");
      for (const plot of inside) found.push([plot, +(box.dataset.left ?? 0), +(box.dataset.width ?? 100)]);
    }
    return found;
  }
  let heads = [], headed = null;
  document.addEventListener("playhead", ({ detail }) => {
    if (headed !== detail.take) {
      for (const [line] of heads) line.remove();
      headed = detail.take;
      heads = plots(detail.take).map(([plot, left, width]) => {
        const line = document.createElementNS(plot.namespaceURI, "line");
        line.setAttribute("class", "playhead");
        line.setAttribute("y1", "0");
        line.setAttribute("y2", "100%");
        plot.append(line);
        return [line, left, width];
      });
    }
    for (const [line, left, width] of heads) {
      const x = `${(left + width * detail.frame / detail.frames).toFixed(3)}%`;
      line.setAttribute("x1", x);
      line.setAttribute("x2", x);
    }
  });
  document.addEventListener("playend", () => { for (const [line] of heads) line.remove(); heads = []; headed = null; });

  for (const block of document.querySelectorAll("rect[data-start]")) {
    if (!motionOf(block)) continue;
    block.setAttribute("tabindex", "0");
    block.setAttribute("role", "button");
    block.classList.add("playable");
  }
  document.addEventListener("click", event => {
    let block = event.target.closest("[data-start]");
    const plot = block ? null : event.target.closest("svg.plot");
    if (plot) {  // a finger is wider than a short segment: the nearest one within 20 pixels is meant
      const away = one => { const { left, right } = one.getBoundingClientRect(); return Math.max(left - event.clientX, event.clientX - right); };
      block = [...plot.querySelectorAll("rect.playable")].map(one => [away(one), one]).filter(([d]) => d <= 20).sort((a, b) => a[0] - b[0])[0]?.[1];
    }
    if (block) show(block);
  });
  document.addEventListener("keydown", event => {
    if (event.key === "Escape") close.click();
    if (event.key !== "Enter" && event.key !== " ") return;
    const block = event.target.closest?.("[data-start]");
    if (block && !(block instanceof HTMLButtonElement)) { event.preventDefault(); show(block); }
  });
  play.addEventListener("click", () => run(!running));
  time.addEventListener("input", () => { loop.checked = false; at = +time.value; draw(); });
  wide?.addEventListener("change", draw);
  close.addEventListener("click", () => {
    run(false);
    player.hidden = true;
    playing?.block.classList.remove("playing");
    document.dispatchEvent(new CustomEvent("playend"));
  });
  canvas.addEventListener("pointermove", event => { if (event.buttons) { turn += event.movementX / 120; draw(); } });

  // Small figures move while they are on the screen; with reduced motion they stand still in the middle of their interval.
  const visible = new Map();
  function move(moment) {
    for (const [small, [motion, begin, length]] of visible) {
      const pen = small.getContext("2d"), frame = begin + (calm ? length / 2 : (moment / 1000 * rate(motion)) % length);
      pen.clearRect(0, 0, small.width, small.height);
      figure(pen, motion, index(motion, frame), front(motion, begin), 0, small.width);
    }
    if (visible.size && !calm) requestAnimationFrame(move);
  }
  const watch = new IntersectionObserver(entries => {
    for (const { target, isIntersecting } of entries) {
      if (!isIntersecting) visible.delete(target);
      else unpack(motionOf(target)).then(motion => {
        const first = !visible.size;
        visible.set(target, [motion, +target.dataset.start, target.dataset.stop - target.dataset.start]);
        if (calm || first) requestAnimationFrame(move);
      });
    }
  });
  for (const small of document.querySelectorAll("canvas[data-start]")) if (motionOf(small)) watch.observe(small);
})();
