// Parts of the viewer that draw nothing.
import assert from "node:assert/strict";
import { test } from "node:test";
import { orbit, target, zoom } from "../../../client/web/view/camera.js";
import { Pace } from "../../../client/web/view/pace.js";
import { Stance } from "../../../client/web/view/stance.js";

const UP = [0, -1, 0];

/** A camera of a rig around the origin, 3 away from it. */
function eye(angle) {
  const forward = [-Math.sin(angle), 0, Math.cos(angle)], right = [Math.cos(angle), 0, Math.sin(angle)];
  const at = [3 * Math.sin(angle), 0, -3 * Math.cos(angle)], rows = [right, [0, 1, 0], forward];
  const m = rows.flatMap((r) => [...r, -(r[0] * at[0] + r[1] * at[1] + r[2] * at[2])]);
  return { name: `at ${angle}`, width: 320, height: 180, intrinsics: [200, 0, 160, 0, 200, 90, 0, 0, 1], worldToCamera: [...m, 0, 0, 0, 1] };
}

const RIG = [-0.4, 0, 0.7].map(eye);

/** A stance where everything lies so far away, and what it fired. */
function stand({ depth = 3, isStill = true } = {}) {
  const stance = new Stance(async () => depth, () => isStill), fired = [];
  for (const name of ["changed", "steered"]) stance.addEventListener(name, () => fired.push(name));
  return { stance, fired };
}

const answered = () => new Promise((resolve) => setImmediate(resolve));

test("a visit begins in the middle of the rig, and goes around what that camera sees", async () => {
  const { stance, fired } = stand({ depth: 2.5 });
  stance.meet(RIG);
  assert.deepEqual(stance.pose.position.map((x) => Number(x.toFixed(6))), [0, 0, -3]);
  assert.deepEqual(fired, ["changed"]);
  await answered();
  assert.equal(stance.pose.distance, 2.5);
  assert.equal(stance.home.distance, 2.5);
  assert.equal(stance.outside, 0);
});

test("a later scene, and one after somebody chose a pose, leave the pose alone", async () => {
  for (const first of [true, false]) {
    const { stance } = stand();
    if (!first) stance.meet(RIG);
    await answered();
    stance.steer(orbit(stance.pose, UP, 0.2, 0));
    const { pose } = stance;
    stance.meet(RIG);
    await answered();
    assert.deepEqual(stance.pose, pose);
  }
});

test("a depth that comes after somebody went elsewhere changes nothing", async () => {
  const { stance } = stand({ depth: 9 });
  stance.standAt(RIG[2]);
  stance.moveTo({ ...stance.pose, distance: 1 });
  await answered();
  assert.equal(stance.pose.distance, 1);
});

test("a glide ends where it leads, also where its depth comes on the way", async () => {
  const { stance, fired } = stand({ depth: 2, isStill: false });
  const begin = stance.pose.position;
  stance.standAt(RIG[2]);
  assert.deepEqual([stance.pose.position, fired], [begin, []], "nothing is changed before the next frame");
  await answered();
  stance.step(stance.glide.start + 100);
  const between = stance.pose.position[0], { to } = stance.glide;
  assert.ok(0 < between && between < to.position[0]);
  stance.step(stance.glide.start + 10_000);
  assert.deepEqual([stance.pose, stance.pose.distance, stance.glide], [to, 2, null]);
  assert.deepEqual(fired, ["changed", "changed"]);
  stance.step(0);
  assert.equal(fired.length, 2);
});

test("a hand ends a glide, tells so, and cannot leave what the rig has seen", async () => {
  const { stance, fired } = stand({ isStill: false });
  stance.meet(RIG);
  await answered();
  stance.standAt(RIG[0]);
  fired.length = 0;
  stance.steer(orbit(stance.pose, UP, 0.01, 0));
  assert.deepEqual([fired, stance.glide, stance.posed], [["steered", "changed"], null, true]);
  for (let i = 0; i < 500; i++) stance.steer(zoom(stance.pose, 1.2));
  assert.ok(stance.outside > 0.5 && Math.hypot(...target(stance.pose)) < 1 && Math.hypot(...stance.pose.position) < 13);
  stance.forget();
  assert.deepEqual([stance.outside, stance.home, stance.posed], [0, null, false]);
});

test("a rate counts what was drawn while things move, and frames that came late", () => {
  const pace = new Pace();
  pace.tick(0);
  for (let i = 0; i < 10; i++) {
    pace.draw(100 * i, true, false);
    assert.deepEqual(pace.tick(100 * (i + 1)), { ms: 100, drew: true, all: false });
  }
  assert.equal(pace.frameMs, 100);
  assert.ok(Math.abs(pace.fps - 10) < 1e-6);
  pace.tick(1016); // nothing was drawn: not waited for
  assert.equal(pace.sustained(), 10);
  assert.equal(pace.sustained(), null, "too little since then");
});

test("what was drawn in full is told, but is no measure of movement; nor is time in which nobody looked", () => {
  const pace = new Pace();
  pace.tick(0);
  pace.draw(0, false, true);
  assert.deepEqual(pace.tick(10), { ms: 10, drew: true, all: true });
  assert.equal(pace.frameMs, 0);
  pace.draw(10, true, true);
  pace.skip();
  assert.equal(pace.tick(60_000).drew, false);
  pace.draw(60_000, true, true);
  assert.equal(pace.tick(70_000).drew, false, "asleep");
  assert.deepEqual([pace.frameMs, pace.sustained()], [0, null]);
});
