"use strict";
// Links the plots by station and draws the view in space. All data is in the page; nothing is loaded.
(() => {
  const $ = (id) => document.getElementById(id);
  const report = JSON.parse($("data").textContent);
  const { stations, legs, paths, board, robot } = report;
  // A link of the contents opens its section.
  const open = () => {
    const target = location.hash && $(location.hash.slice(1));
    if (target && target.tagName === "DETAILS") target.open = true;
  };
  window.addEventListener("hashchange", open);
  open();
  if (!stations.length) return;
  const marks = [...document.querySelectorAll("[data-s]")].map((element) => ({
    element,
    own: element.dataset.s.split(" ").map(Number),
  }));
  const list = $("station"), view = $("view"), said = $("picked"), context = view.getContext("2d");
  let picked = -1, log = stations[0].log, yaw = -0.9, pitch = 0.5, zoom = 1, close = false;

  const several = new Set(stations.map((s) => s.log)).size > 1;
  const name = (k) => (several ? `${stations[k].log + 1}:${stations[k].station}` : `${stations[k].station}`);
  stations.forEach((_, k) => list.append(new Option(`station ${name(k)}`, k)));

  // -- selection ------------------------------------------------------------------------------------
  function pick(k) {
    picked = k;
    if (k >= 0) log = stations[k].log;
    list.value = k;
    document.body.classList.toggle("picking", k >= 0);
    for (const { element, own } of marks) element.classList.toggle("on", own.includes(k));
    const pictures = [...document.querySelectorAll(`#stations > .view[data-view="${k}"]`)].slice(0, 1);
    $("images").replaceChildren(...pictures.map((found) => {
      const copy = found.cloneNode(true);
      copy.hidden = false;
      return copy;
    }));
    tell();
    draw();
  }
  function tell() {
    if (close) said.textContent = describeRobot();
    else if (picked >= 0) said.textContent = describe(picked);
    else said.textContent = "Pick a station: all plots highlight it. Red: its view of the board against the mean, magnified 10 times.";
  }
  function describeRobot() {
    const place = (T) => T.map((row) => row[3].toFixed(4)).join(", ");
    const { frames, cameras } = atStation(shown());
    const poses = cameras.map(([label, T]) => `${label} at ${place(T)} m`);
    return `Robot at station ${name(shown())}, in ${frames[0][0]}: ${poses.join("; ")}. Axes: x red, y green, z blue.`;
  }
  function describe(k) {
    const s = stations[k];
    const joints = Object.entries(s.joints).map(([joint, value]) => `${joint} ${value.toFixed(3)}`).join(", ");
    const own = legs.filter((leg) => leg.from_observation === k || leg.to_observation === k).map((leg) =>
      `leg ${name(leg.from_observation)}–${name(leg.to_observation)}: ${leg.point_rms_mm.toFixed(1)} mm, ` +
      `${leg.reprojection_px.toFixed(2)} px`);
    return `Station ${name(k)}: base at x ${s.base_x_m.toFixed(2)} m, y ${s.base_y_m.toFixed(2)} m, heading ` +
      `${s.base_heading_deg.toFixed(0)}°; joints (rad or m): ${joints}; board at ${s.board_distance_m.toFixed(2)} m, residual ` +
      `${s.stereo_reprojection_px.toPrecision(2)} px. ${own.join("; ")}`;
  }
  const step = (by) => pick(picked < 0 ? (by > 0 ? 0 : stations.length - 1) : (picked + by + stations.length) % stations.length);
  list.addEventListener("change", () => pick(Number(list.value)));
  $("previous").addEventListener("click", () => step(-1));
  $("next").addEventListener("click", () => step(1));
  $("clear").addEventListener("click", () => pick(-1));
  document.addEventListener("click", (event) => {
    const mark = event.target.closest && event.target.closest("[data-s]");
    if (!mark) return;
    const own = mark.dataset.s.split(" ").map(Number);
    pick(own[(own.indexOf(picked) + 1) % own.length]);
  });

  // -- view in space --------------------------------------------------------------------------------
  const at = (T, p) => T.map((row) => row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3]);
  const shown = () => Math.max(picked, 0);
  const times = (A, B) => A.map((row) => [0, 1, 2, 3].map((k) => row[0] * B[0][k] + row[1] * B[1][k] + row[2] * B[2][k] + (k === 3 ? row[3] : 0)));
  // Motion of a joint, as three rows: along its axis, or about it (Rodrigues).
  function motion({ axis, prismatic }, reading) {
    const length = Math.hypot(...axis), angle = prismatic ? 0 : reading * length, [c, s] = [Math.cos(angle), Math.sin(angle)];
    const [x, y, z] = axis.map((v) => v / (length || 1)), across = [[0, -z, y], [z, 0, -x], [-y, x, 0]];
    return [x, y, z].map((v, i) => [...[x, y, z].map((w, k) => (i === k ? c : 0) + (1 - c) * v * w + s * across[i][k]),
      prismatic ? axis[i] * reading : 0]);
  }
  // The robot's frames at a station in its base, and the reference camera as estimated and as described.
  function atStation(k) {
    let T = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]];
    const frames = [[robot.base_frame, T]];
    for (const frame of robot.frames) {
      T = times(times(T, frame.T_parent_frame), motion(frame, stations[k].joints[frame.name] || 0));
      frames.push([frame.name, T]);
    }
    const cameras = [["estimated camera", times(T, robot.camera)]];
    if (robot.nominal_camera) cameras.push(["nominal camera", times(T, robot.nominal_camera)]);
    return { frames, cameras };
  }
  const corners = [[-1, -1], [board.columns, -1], [board.columns, board.rows], [-1, board.rows]]
    .map(([x, y]) => [x * board.square_mm / 1000, y * board.square_mm / 1000, 0]);
  const mean = (points) => points.reduce((sum, p) => sum.map((v, k) => v + p[k] / points.length), [0, 0, 0]);
  let project, ends = [];

  function extent(all) {
    const low = [0, 1, 2].map((k) => Math.min(...all.map((p) => p[k])));
    const high = [0, 1, 2].map((k) => Math.max(...all.map((p) => p[k])));
    const size = Math.max(Math.hypot(...high.map((v, k) => v - low[k])), 0.1);
    return { middle: low.map((v, k) => (v + high[k]) / 2), low, high, size };
  }
  function prepare() {
    const own = stations.filter((s) => s.log === log);
    const path = (paths.find((p) => p.log === log) || { points_m: [] }).points_m.map(([x, y]) => [x, y, 0]);
    const boards = own.map((s) => corners.map((c) => at(s.T_world_board, c)));
    const cameras = own.map((s) => at(s.T_world_camera, [0, 0, 0]));
    const all = [...path, ...cameras, ...boards.flat(), ...own.map((s) => at(s.T_world_base, [0, 0, 0]))];
    return { own, path, boards, ...extent(all), usual: corners.map((_, k) => mean(boards.map((b) => b[k]))) };
  }
  function prepareRobot() {
    const scene = atStation(shown()), origins = [...scene.frames, ...scene.cameras].map(([, T]) => at(T, [0, 0, 0]));
    const around = extent(origins);
    return { ...scene, origins, ...around, size: 1.4 * around.size }; // room for axes and names
  }
  function draw() {
    const scene = close ? prepareRobot() : prepare(), { middle, low, high, size } = scene;
    const wide = view.clientWidth, tall = view.clientHeight;
    if (!wide) return; // its section is collapsed
    const dense = window.devicePixelRatio || 1;
    view.width = wide * dense;
    view.height = tall * dense;
    context.setTransform(dense, 0, 0, dense, 0, 0);
    const style = getComputedStyle(document.documentElement);
    const color = (key) => style.getPropertyValue(`--${key}`).trim();
    const unit = zoom * Math.min(wide, tall) / size;
    const [c, s, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
    project = (p) => {
      const [x, y, z] = p.map((v, k) => v - middle[k]);
      const depth = -s * x + c * y;
      return [wide / 2 + unit * (c * x + s * y), tall / 2 - unit * (cp * z + sp * depth)];
    };
    const line = (points, ink, width = 1, closed = false) => {
      context.beginPath();
      points.map(project).forEach(([x, y], k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
      if (closed) context.closePath();
      context.strokeStyle = color(ink);
      context.lineWidth = width;
      context.stroke();
    };
    const camera = (T, far, width, ink) => {
      const rim = [[-1, -0.75], [1, -0.75], [1, 0.75], [-1, 0.75]].map(([x, y]) => at(T, [x * far / 2, y * far / 2, far]));
      line(rim, ink, width, true);
      rim.forEach((p) => line([at(T, [0, 0, 0]), p], ink, width * 0.7));
    };
    const names = [];
    const axes = (T, length, labeled) => [["x", "red", [length, 0, 0]], ["y", "green", [0, length, 0]], ["z", "blue", [0, 0, length]]]
      .forEach(([axis, ink, end]) => {
        line([at(T, [0, 0, 0]), at(T, end)], ink, 2.5);
        if (labeled) names.push([axis, true, ...project(at(T, end))]);
      });
    ends = [];
    if (close) {
      const { frames, cameras, origins } = scene;
      line(origins.slice(0, frames.length + 1), "faint", 3);
      frames.forEach(([, T]) => axes(T, 0.15 * size));
      cameras.forEach(([, T], k) => camera(T, 0.2 * size, k ? 1 : 2, k ? "soft" : "orange"));
      [...cameras, ...frames.reverse()].forEach(([text, T], k) => names.push([text, k < 1, ...project(at(T, [0, 0, 0]))]));
    } else drawStations(scene, line, axes, camera, names);
    scaleBar(unit, wide, tall, color("ink"), names);
    write(names, color);
  }
  function drawStations({ own, path, boards, low, high, usual }, line, axes, camera, names) {
    const grid = [Math.floor(low[0]), Math.ceil(high[0]), Math.floor(low[1]), Math.ceil(high[1])];
    const every = Math.max(1, Math.round((grid[1] - grid[0] + grid[3] - grid[2]) / 30));
    for (let x = grid[0]; x <= grid[1]; x += every) line([[x, grid[2], 0], [x, grid[3], 0]], "line");
    for (let y = grid[2]; y <= grid[3]; y += every) line([[grid[0], y, 0], [grid[1], y, 0]], "line");
    line(path, "soft", 1.5);
    axes([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], 0.5, true); // the world: the base at the first station
    own.forEach((station, n) => {
      const k = stations.indexOf(station), on = k === picked, faded = picked >= 0 && !on;
      context.globalAlpha = faded ? 0.3 : 1;
      const base = (p) => at(station.T_world_base, p), eye = (p) => at(station.T_world_camera, p);
      line([[0.12, 0, 0], [-0.08, 0.08, 0], [-0.08, -0.08, 0]].map(base), "blue", on ? 3 : 1.5, true);
      line([base([0, 0, 0]), eye([0, 0, 0])], "faint", 1);
      camera(station.T_world_camera, 0.16, on ? 2.5 : 1.2, "orange");
      line(boards[n], "green", on ? 3 : 1, true);
      if (on) boards[n].forEach((p, i) => line([usual[i], usual[i].map((v, a) => v + 10 * (p[a] - v))], "red", 2));
      context.globalAlpha = 1;
      ends.push([k, project(base([0, 0, 0]))], [k, project(eye([0, 0, 0]))]);
      if (on || own.length <= 40) names[on ? "unshift" : "push"]([name(k), on, ...project(base([0, 0, 0]))]);
    });
  }
  // The longest round length that fits.
  function scaleBar(unit, wide, tall, ink, names) {
    const meters = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10].filter((length) => length * unit < wide / 3).pop() || 0.01;
    context.beginPath();
    context.moveTo(12, tall - 12);
    context.lineTo(12 + meters * unit, tall - 12);
    context.strokeStyle = ink;
    context.lineWidth = 2;
    context.stroke();
    names.unshift([`${meters} m`, true, 12 + meters * unit, tall - 15]);
  }
  // Names over the lines; the first ones first, and none over another.
  function write(names, color) {
    const taken = [];
    context.lineWidth = 3;
    context.lineJoin = "round";
    context.strokeStyle = color("card");
    context.fillStyle = color("ink");
    for (const [text, on, x, y] of names) {
      context.font = `${on ? "600 14px" : "12px"} system-ui, sans-serif`;
      const span = context.measureText(text).width;
      const free = [[6, 14], [6, -5], [-6 - span, 14], [-6 - span, -5]].map(([dx, dy]) => [x + dx, y + dy]).find(([left, bottom]) =>
        taken.every(([l, b, w]) => left > l + w || l > left + span || Math.abs(bottom - b) > 12));
      if (!free) continue;
      taken.push([...free, span]);
      context.strokeText(text, ...free);
      context.fillText(text, ...free);
    }
  }
  let from = null, moved = false;
  view.addEventListener("pointerdown", (event) => {
    from = [event.clientX, event.clientY];
    moved = false;
    view.setPointerCapture(event.pointerId);
  });
  view.addEventListener("pointermove", (event) => {
    if (!from) return;
    const [x, y] = [event.clientX - from[0], event.clientY - from[1]];
    if (!moved && Math.hypot(x, y) < 4) return;
    moved = true;
    from = [event.clientX, event.clientY];
    turn(x * 0.01, y * 0.01);
  });
  view.addEventListener("pointercancel", () => (from = null));
  view.addEventListener("pointerup", (event) => {
    from = null;
    if (moved) return;
    const near = ends.map(([k, [x, y]]) => [Math.hypot(x - event.offsetX, y - event.offsetY), k]).sort((a, b) => a[0] - b[0])[0];
    pick(near && near[0] < 24 ? near[1] : -1);
  });
  function turn(by, up) {
    yaw -= by;
    pitch = Math.min(Math.PI / 2, Math.max(-0.2, pitch + up));
    draw();
  }
  function scale(by) {
    zoom = Math.min(20, Math.max(0.3, zoom * by));
    draw();
  }
  view.addEventListener("wheel", (event) => {
    if (!event.ctrlKey) return; // scrolling over the view scrolls the page
    event.preventDefault();
    scale(Math.exp(-event.deltaY / 500));
  }, { passive: false });
  const keys = {
    ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0), ArrowUp: () => turn(0, -0.1), ArrowDown: () => turn(0, 0.1),
    "+": () => scale(1.25), "-": () => scale(0.8), n: () => step(1), p: () => step(-1), Escape: () => pick(-1),
  };
  view.addEventListener("keydown", (event) => {
    if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    keys[event.key]();
  });
  $("closer").addEventListener("click", () => scale(1.25));
  $("farther").addEventListener("click", () => scale(0.8));
  $("robot").addEventListener("click", () => {
    [close, zoom] = [!close, 1];
    $("robot").setAttribute("aria-pressed", close);
    tell();
    draw();
  });
  $("above").addEventListener("click", () => { [yaw, pitch, zoom] = [0, Math.PI / 2, 1]; draw(); });
  window.addEventListener("resize", draw);
  $("stations").addEventListener("toggle", draw);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  for (const element of document.querySelectorAll(".scripted")) element.hidden = false;
  pick(-1);
})();
