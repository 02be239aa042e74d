// Motions as the server sends them (explorer/motion.py): blocks of 16-bit positions, decoded as they arrive.

export const UNKNOWN = -32768;
const HEADER = 48;

/** Consecutive stored frames of a take. Position = origin + unit * number; a number −32768 is unknown. */
export interface Block {
  first: number;
  step: number;
  frames: number;
  joints: number;
  rateHz: number;
  unit: number;
  origin: readonly [number, number, number];
  numbers: Int16Array;
}

/** Return the block at a place of a buffer and the place after it; null where the block is not there whole. */
export function readBlock(buffer: ArrayBuffer, place: number, end = buffer.byteLength): [Block, number] | null {
  if (end - place < HEADER) return null;
  const view = new DataView(buffer, place, HEADER);
  if (view.getUint32(0) !== 0x4b4e5831) throw new Error("the server sent something else than a motion");
  const frames = view.getUint32(4, true);
  const joints = view.getUint32(8, true);
  const stop = place + HEADER + 6 * frames * joints;
  if (stop > end) return null;
  const float = (at: number) => view.getFloat32(at, true);
  return [
    {
      first: view.getUint32(12, true),
      step: view.getUint32(16, true),
      frames,
      joints,
      rateHz: float(20),
      unit: float(24),
      origin: [float(28), float(32), float(36)],
      numbers: new Int16Array(buffer.slice(place + HEADER, stop)),
    },
    stop,
  ];
}

/** Return the figures of an answer of POST /api/figures, one block each. */
export function readFigures(buffer: ArrayBuffer): Block[] {
  const view = new DataView(buffer);
  const found: Block[] = [];
  let place = 4;
  for (let left = view.getUint32(0, true); left > 0; left--) {
    const length = view.getUint32(place, true);
    const read = readBlock(buffer, place + 4, place + 4 + length);
    if (read === null) throw new Error("the server sent a figure that is not whole");
    found.push(read[0]);
    place += 4 + length;
  }
  return found;
}

/** Read the blocks of a stream as they arrive. */
export async function readBlocks(stream: ReadableStream<Uint8Array>, found: (block: Block) => void): Promise<void> {
  const reader = stream.getReader();
  let held = new Uint8Array(1 << 16);
  let used = 0;
  for (;;) {
    const { done, value } = await reader.read();
    if (done) break;
    if (used + value.length > held.length) {
      const larger = new Uint8Array(Math.max(2 * held.length, used + value.length));
      larger.set(held.subarray(0, used));
      held = larger;
    }
    held.set(value, used);
    used += value.length;
    let place = 0;
    for (let read = readBlock(held.buffer, 0, used); read !== null; read = readBlock(held.buffer, place, used)) {
      found(read[0]);
      place = read[1];
    }
    held.copyWithin(0, place, used);
    used -= place;
  }
  if (used > 0) throw new Error("the motion ends in the middle of a block; is the server still running?");
}

/** The motion of a take, or of a part of it, which may still be on its way. */
export class Motion {
  private readonly blocks: Block[] = [];
  private last = 0;

  /** Add a block; blocks come in any order and do not overlap. */
  add(block: Block): void {
    if (block.frames === 0) return;
    const place = this.blocks.findIndex((one) => one.first > block.first);
    if (place < 0) this.blocks.push(block);
    else this.blocks.splice(place, 0, block);
  }

  get joints(): number {
    return this.blocks[0]?.joints ?? 0;
  }

  get rateHz(): number {
    return this.blocks[0]?.rateHz ?? 0;
  }

  /** First analysis frame. */
  get first(): number {
    return this.blocks[0]?.first ?? 0;
  }

  /** Analysis frame after the last that has arrived. */
  get stop(): number {
    const block = this.blocks.at(-1);
    return block === undefined ? 0 : block.first + block.frames * block.step;
  }

  private find(frame: number): Block | null {
    const near = this.blocks[this.last];
    if (near !== undefined && within(near, frame)) return near;
    let low = 0;
    let high = this.blocks.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if ((this.blocks[middle] as Block).first <= frame) low = middle;
      else high = middle - 1;
    }
    const block = this.blocks[low];
    if (block === undefined || !within(block, frame)) return null;
    this.last = low;
    return block;
  }

  /** Return whether the pose of a frame has arrived. */
  has(frame: number): boolean {
    return this.find(Math.floor(frame)) !== null;
  }

  /** Write the positions at a frame, interpolated, into 3 J numbers (NaN where unknown); false where there are none. */
  pose(frame: number, out: Float32Array): boolean {
    const block = this.find(Math.floor(frame));
    if (block === null) return false;
    const at = (frame - block.first) / block.step;
    const row = Math.floor(at);
    const share = at - row;
    writePose(block, row, out, 1 - share);
    if (share > 0) {
      const inside = row + 1 < block.frames;
      const next = inside ? block : this.find(block.first + block.frames * block.step);
      if (next === null) writePose(block, row, out, 1);
      else addPose(next, inside ? row + 1 : 0, out, share, block, row);
    }
    return true;
  }
}

function within(block: Block, frame: number): boolean {
  return frame >= block.first && frame < block.first + block.frames * block.step;
}

function writePose(block: Block, row: number, out: Float32Array, share: number): void {
  const { numbers, unit, origin, joints } = block;
  let place = 3 * joints * row;
  for (let i = 0; i < 3 * joints; i++, place++) {
    const number = numbers[place] as number;
    out[i] = number === UNKNOWN ? NaN : (origin[(i % 3) as 0 | 1 | 2] + unit * number) * share;
  }
}

/** Add the share of the next pose; where that is unknown, the pose before it stays. */
function addPose(block: Block, row: number, out: Float32Array, share: number, before: Block, at: number): void {
  const { numbers, unit, origin, joints } = block;
  let place = 3 * joints * row;
  for (let i = 0; i < 3 * joints; i++, place++) {
    const number = numbers[place] as number;
    if (number !== UNKNOWN) out[i] = (out[i] as number) + (origin[(i % 3) as 0 | 1 | 2] + unit * number) * share;
    else if (!Number.isNaN(out[i])) out[i] = coordinate(before, at, i);
  }
}

function coordinate(block: Block, row: number, i: number): number {
  const number = block.numbers[3 * block.joints * row + i] as number;
  return number === UNKNOWN ? NaN : block.origin[(i % 3) as 0 | 1 | 2] + block.unit * number;
}

/** Write the positions of a stored frame of a figure, without interpolation. */
export function figurePose(block: Block, row: number, out: Float32Array): void {
  writePose(block, row, out, 1);
}
