import { describe, expect, it } from "vitest";

import { facing, makeBody, sideOf } from "./body";
import { place, writeBone } from "./bones";
import { type Block, Motion, readBlock, readBlocks, readFigures, UNKNOWN } from "./motion";

/** Return a block as the server writes it: `frames` rows of the same step to the right. */
function written(first: number, rows: readonly (readonly number[])[], unit = 0.5, origin = [10, 0, -4], step = 1): ArrayBuffer {
  const joints = (rows[0]?.length ?? 3) / 3;
  const buffer = new ArrayBuffer(48 + 6 * joints * rows.length);
  const view = new DataView(buffer);
  view.setUint32(0, 0x4b4e5831);
  [rows.length, joints, first, step].forEach((value, i) => view.setUint32(4 + 4 * i, value, true));
  [30, unit, ...origin].forEach((value, i) => view.setFloat32(20 + 4 * i, value, true));
  rows.flat().forEach((value, i) => view.setInt16(48 + 2 * i, value, true));
  return buffer;
}

const read = (buffer: ArrayBuffer): Block => (readBlock(buffer, 0) as [Block, number])[0];

function joined(...parts: ArrayBuffer[]): Uint8Array {
  return new Uint8Array(parts.flatMap((part) => [...new Uint8Array(part)]));
}

describe("blocks of a motion", () => {
  it("are read with their header, and only when they are there whole", () => {
    const buffer = written(7, [[2, 4, 6]]);
    expect(read(buffer)).toMatchObject({ first: 7, frames: 1, joints: 1, rateHz: 30, step: 1, unit: 0.5 });
    expect(readBlock(buffer, 0, buffer.byteLength - 1)).toBeNull();
    expect(() => readBlock(new ArrayBuffer(64), 0)).toThrow("something else than a motion");
  });

  it("arrive in pieces of any size", async () => {
    const bytes = joined(written(0, [[0, 0, 0], [2, 0, 0]]), written(2, [[4, 0, 0]]));
    for (const size of [1, 13, 60, 1000]) {
      const found: Block[] = [];
      const pieces = Array.from({ length: Math.ceil(bytes.length / size) }, (_, i) => bytes.slice(i * size, (i + 1) * size));
      const stream = new ReadableStream<Uint8Array>({
        pull: (controller) => {
          const piece = pieces.shift();
          if (piece === undefined) controller.close();
          else controller.enqueue(piece);
        },
      });
      await readBlocks(stream, (block) => found.push(block));
      expect(found.map((block) => [block.first, block.frames])).toEqual([[0, 2], [2, 1]]);
    }
  });

  it("that end too early are an error", async () => {
    const stream = new Response(written(0, [[0, 0, 0]]).slice(0, 50)).body as ReadableStream<Uint8Array>;
    await expect(readBlocks(stream, () => {})).rejects.toThrow("in the middle of a block");
  });
});

describe("a pose", () => {
  const motion = new Motion();
  motion.add(read(written(2, [[8, 0, 0]], 0.25)));
  motion.add(read(written(0, [[0, 2, 0], [2, UNKNOWN, 0]])));
  const pose = new Float32Array(3);

  it("lies between two frames, also of two blocks with units of their own", () => {
    expect(motion.pose(0.5, pose)).toBe(true);
    expect([...pose]).toEqual([10.5, 1, -4]);
    expect(motion.pose(1.5, pose)).toBe(true);
    expect(pose[0]).toBeCloseTo(11.5);
    expect([motion.first, motion.stop]).toEqual([0, 3]);
  });

  it("keeps a coordinate that is not known next, and lacks one that is not known now", () => {
    motion.pose(0.75, pose);
    expect(pose[1]).toBe(1);
    motion.pose(1, pose);
    expect(pose[1]).toBeNaN();
  });

  it("is not there before it has arrived", () => {
    expect(motion.pose(3, pose)).toBe(false);
    expect(new Motion().pose(0, pose)).toBe(false);
    expect(motion.pose(2, pose)).toBe(true);
  });
});

it("figures are read one by one", () => {
  const blocks = [written(5, [[0, 0, 0]]), written(9, [[1, 1, 1], [2, 2, 2]])];
  const parts = blocks.flatMap((block) => [new Uint32Array([block.byteLength]).buffer as ArrayBuffer, block]);
  const found = readFigures(joined(new Uint32Array([2]).buffer as ArrayBuffer, ...parts).buffer as ArrayBuffer);
  expect(found.map((block) => [block.first, block.frames])).toEqual([[5, 1], [9, 2]]);
});

describe("a body", () => {
  const body = makeBody(["root", "lhip", "rhip"], [-1, 0, 0]);

  it("has bones, sides and a direction", () => {
    expect(body.bones).toEqual([[0, 1], [0, 2]]);
    expect(body.sides).toEqual(["middle", "left", "right"]);
    expect(["rhand_fast", "hands_apart", "root_fast"].map(sideOf)).toEqual(["right", "middle", "right"]);
    expect(facing(body, new Float32Array([0, 1, 0, 1, 1, 0, -1, 1, 0]))).toBeCloseTo(0);
    expect(facing(body, new Float32Array([0, 1, 0, 0, 1, -1, 0, 1, 1]))).toBeCloseTo(Math.PI / 2);
    expect(facing(body, new Float32Array([0, 1, 0, NaN, 1, 0, -1, 1, 0]))).toBeNaN();
  });

  it("stands where it is put and faces +Z", () => {
    const pose = new Float32Array([3, 1, 5, 3, 1, 4, 3, 1, 6]);
    place(pose, { x: 3, z: 5, yaw: facing(body, pose) }, 0.5);
    expect(facing(body, pose)).toBeCloseTo(0);
    expect([pose[0], pose[2]]).toEqual([0.5, 0]);
  });

  it("has cylinders from joint to joint, and none to an unknown joint", () => {
    const matrix = new Float32Array(16);
    const at = (y: number) => [0, 1, 2].map((i) => (matrix[4 + i] as number) * y + (matrix[12 + i] as number));
    writeBone(matrix, 0, new Float32Array([1, 2, 3, 1, 2, 7]), 0, 1);
    expect(at(-0.5)).toEqual([1, 2, 3]);
    expect(at(0.5)).toEqual([1, 2, 7]);
    for (const one of [0, 8])
      for (const other of [4]) {
        const dot = [0, 1, 2].reduce((sum, i) => sum + (matrix[one + i] as number) * (matrix[other + i] as number), 0);
        expect(dot).toBeCloseTo(0);
      }
    writeBone(matrix, 0, new Float32Array([1, 2, 3, NaN, 2, 7]), 0, 1);
    expect(matrix.every((value) => value === 0)).toBe(true);
  });
});
