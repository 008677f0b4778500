'use strict';
// Point blocks, written and read by their byte table, core/codec/FORMAT.md.

const {xxhash3} = require('hash-wasm');

const TYPE_INT32 = 5;
const TYPE_UINT16 = 4;
const FIXED_HEAD_BYTES = 104;
const FIXED_ENTRY_BYTES = 22;
const AXES = ['x', 'y', 'z'];

/** XXH3-64 with seed 0 of `bytes` as a BigInt. */
async function checksum(bytes) {
  return BigInt('0x' + await xxhash3(bytes));
}

const minimum = (values) => values.reduce((a, b) => Math.min(a, b));
const maximum = (values) => values.reduce((a, b) => Math.max(a, b));

/**
 * One block of plain columns.
 *
 * points: [x, y, z] in steps of the lattice; attribute: {name, values}, a uint16
 * each. Not empty.
 */
async function writeBlock(stepNm, points, attribute) {
  const axes = AXES.map((name, axis) => ({
    name, values: points.map((point) => point[axis])}));
  const min = axes.map(({values}) => minimum(values));
  const max = axes.map(({values}) => maximum(values));
  const columns = axes.map(({name, values}, axis) => {
    const bytes = Buffer.alloc(4 * values.length);
    values.forEach((value, i) => bytes.writeInt32LE(value - min[axis], 4 * i));
    return {name, type: TYPE_INT32, bytes};
  });
  const attributeBytes = Buffer.alloc(2 * points.length);
  attribute.values.forEach((value, i) =>
    attributeBytes.writeUInt16LE(value, 2 * i));
  columns.push({name: attribute.name, type: TYPE_UINT16, bytes: attributeBytes});

  const entries = [];
  for (const {name, type, bytes} of columns) {
    const entry = Buffer.alloc(FIXED_ENTRY_BYTES);
    entry.writeUInt8(type, 0);  // transform, compression and flags are 0
    entry.writeUInt32LE(bytes.length, 4);
    entry.writeUInt32LE(bytes.length, 8);
    entry.writeBigUInt64LE(await checksum(bytes), 12);
    entry.writeUInt16LE(Buffer.byteLength(name), 20);
    entries.push(entry, Buffer.from(name));
  }
  const entryBytes = Buffer.concat(entries);
  const data = Buffer.concat(columns.map(({bytes}) => bytes));

  const head = Buffer.alloc(FIXED_HEAD_BYTES);
  const headBytes = FIXED_HEAD_BYTES + entryBytes.length + 8;
  head.write('MSPB', 0, 'latin1');
  head.writeUInt16LE(2, 4);
  head.writeUInt16LE(columns.length, 6);
  head.writeBigUInt64LE(BigInt(headBytes + data.length), 8);
  head.writeUInt32LE(headBytes, 16);
  head.writeUInt32LE(points.length, 20);
  head.writeBigInt64LE(BigInt(stepNm), 24);
  for (let axis = 0; axis < 3; ++axis) {
    head.writeBigInt64LE(BigInt(min[axis]), 32 + 8 * axis);
    head.writeBigInt64LE(BigInt(min[axis]), 56 + 8 * axis);
    head.writeBigInt64LE(BigInt(max[axis]), 80 + 8 * axis);
  }
  const whole = Buffer.concat([head, entryBytes]);
  const sum = Buffer.alloc(8);
  sum.writeBigUInt64LE(await checksum(whole));
  return Buffer.concat([whole, sum, data]);
}

/**
 * A block of plain columns, with all its checksums compared: {pointCount,
 * stepNm, min, max, points, attributes}. points: [x, y, z] in steps of the
 * lattice; attributes: the values of those of type uint16, null of others, by
 * name.
 */
async function readBlock(block) {
  const expect = (isTrue, what) => {
    if (!isTrue) throw new Error(`a point block breaks its format: ${what}`);
  };
  expect(block.subarray(0, 4).toString('latin1') === 'MSPB', 'magic');
  expect(block.readUInt16LE(4) === 2, 'version');
  expect(block.readBigUInt64LE(8) === BigInt(block.length), 'bytes');
  const headBytes = block.readUInt32LE(16);
  expect(block.readBigUInt64LE(headBytes - 8) ===
         await checksum(block.subarray(0, headBytes - 8)), 'checksum of head');
  const corners = (offset) =>
    AXES.map((_, axis) => Number(block.readBigInt64LE(offset + 8 * axis)));

  const pointCount = block.readUInt32LE(20);
  const corner = corners(32);
  const points = Array.from({length: pointCount}, () => []);
  const attributes = {};
  let entry = FIXED_HEAD_BYTES;
  let stored = headBytes;
  for (let i = 0; i < block.readUInt16LE(6); ++i) {
    const storedBytes = block.readUInt32LE(entry + 8);
    const nameBegin = entry + FIXED_ENTRY_BYTES;
    const nameEnd = nameBegin + block.readUInt16LE(entry + 20);
    const name = block.subarray(nameBegin, nameEnd).toString('utf8');
    expect(block.readBigUInt64LE(entry + 12) ===
           await checksum(block.subarray(stored, stored + storedBytes)),
           `checksum of ${name}`);
    expect(block.readUInt16LE(entry + 1) === 0, `${name} is plain`);
    if (i < AXES.length) {
      expect(name === AXES[i] && block.readUInt8(entry) === TYPE_INT32,
             `${AXES[i]} of int32`);
      points.forEach((point, row) =>
        point.push(corner[i] + block.readInt32LE(stored + 4 * row)));
    } else {
      attributes[name] = block.readUInt8(entry) !== TYPE_UINT16 ? null :
        points.map((_, row) => block.readUInt16LE(stored + 2 * row));
    }
    entry = nameEnd;
    stored += storedBytes;
  }
  expect(entry === headBytes - 8, 'bytes of head');
  expect(stored === block.length, 'stored bytes');
  return {pointCount, stepNm: Number(block.readBigInt64LE(24)),
          min: corners(56), max: corners(80), points, attributes};
}

module.exports = {checksum, readBlock, writeBlock};
