/** Voxels of a level as a breadth-first octree, codec/FORMAT.md section 7. */

import { checkAdded, must, Reader } from "./packet.js";
import { inflateColumns, rowCount } from "./deflate.js";
import { BitModels, RansDecoder } from "./rans.js";

const CLASS_OF = [0, 0, 1, 2, 2, 3, 3, 3, 3]; // by number of children

/** @type {(chunk: Uint8Array, room: import("./packet.js").Room) => Int32Array} [N, 3] */
export function decodeGeometry(chunk, room) {
  const reader = new Reader(chunk);
  const coding = reader.u8(),
    count = rowCount(reader);
  if (coding === 0) {
    checkAdded(count, 3, room);
    return differences(inflateColumns(reader, count, 3), count);
  }
  const minimum = [reader.i32(), reader.i32(), reader.i32()];
  const depth = reader.u8();
  must(depth <= 21);
  checkAdded(count, Math.max(3, depth), room);
  const coder = new RansDecoder(reader.rest(), coding);
  const models = new BitModels(4 * 4 * 256);
  let nodes = new Int32Array(3),
    classes = new Uint8Array(1),
    length = 1;
  for (let d = 0; d < depth; d++) {
    const context = Math.min(depth - 1 - d, 3) * 4;
    const most = Math.min(8 * length, count);
    const children = new Int32Array(3 * most),
      childClasses = new Uint8Array(most);
    let born = 0;
    for (let i = 0; i < length; i++) {
      let occupancy = 0,
        prefix = 1;
      for (let j = 0; j < 8; j++) {
        const bit = j === 7 && occupancy === 0 ? 1 : coder.flag(models, ((context + classes[i]) << 8) | prefix);
        occupancy |= bit << j;
        prefix = prefix * 2 + bit;
      }
      const first = born;
      for (let j = 0; j < 8; j++) {
        if (!((occupancy >> j) & 1)) continue;
        must(born < most);
        children[3 * born] = 2 * nodes[3 * i] + (j >> 2);
        children[3 * born + 1] = 2 * nodes[3 * i + 1] + ((j >> 1) & 1);
        children[3 * born + 2] = 2 * nodes[3 * i + 2] + (j & 1);
        born++;
      }
      childClasses.fill(CLASS_OF[born - first], first, born);
    }
    [nodes, classes, length] = [children, childClasses, born];
  }
  coder.end();
  must(length === count);
  const least = [Infinity, Infinity, Infinity];
  let greatest = 0;
  for (let i = 0; i < 3 * count; i++) {
    least[i % 3] = Math.min(least[i % 3], nodes[i]);
    greatest = Math.max(greatest, nodes[i]);
  }
  must(least.every((x) => x === 0) && 32 - Math.clz32(greatest) === depth); // the smallest cube
  const voxel = new Int32Array(3 * count);
  for (let i = 0; i < voxel.length; i++) {
    const sum = nodes[i] + minimum[i % 3];
    must(sum === (sum | 0), "overflow");
    voxel[i] = sum;
  }
  return voxel;
}

/** @type {(columns: Int32Array, rows: number) => Int32Array} */
function differences(columns, rows) {
  const voxel = new Int32Array(3 * rows);
  for (let c = 0; c < 3; c++) {
    for (let i = 0, sum = 0; i < rows; i++) {
      sum = (sum + columns[c * rows + i]) | 0; // modulo 2^32
      voxel[3 * i + c] = sum;
    }
  }
  return voxel;
}
