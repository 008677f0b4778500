'use strict';
// The main path as a client walks it that knows proto/README.md, the protos and
// core/codec/FORMAT.md, and whose gRPC is not ours.
//
// usage: node main_path.js ADDRESS PROTO_FOLDER   the protos, loaded from files
//        node main_path.js ADDRESS --reflection   what the server tells of them

const assert = require('node:assert/strict');
const grpc = require('@grpc/grpc-js');
const protoLoader = require('@grpc/proto-loader');
const {GrpcReflection} = require('grpc-js-reflection-client');
const {xxhash128} = require('hash-wasm');
const {checksum, readBlock, writeBlock} = require('./point_block.js');

const FORM = {keepCase: true, longs: String, enums: String, defaults: true,
              oneofs: true};
const SERVICES = ['MapService', 'UploadService', 'ProcessingService',
                  'QueryService', 'Operations'];
const STEP_NM = 1000000;
const PIECE_BYTES = 10000;

/** Descriptors of all services, from files or from the server itself. */
async function loadApi(address, credentials, how) {
  if (how !== '--reflection') {
    const files = ['map_service', 'upload_service', 'processing_service',
                   'query_service', 'operations'];
    return protoLoader.load(files.map((name) => `mapsieve/v1/${name}.proto`),
                            {...FORM, includeDirs: [how]});
  }
  const reflection = new GrpcReflection(address, credentials);
  const listed = await reflection.listServices();
  const api = {};
  for (const service of SERVICES) {
    const name = `mapsieve.v1.${service}`;
    assert.ok(listed.includes(name), `${name} is not among ${listed}`);
    const descriptor = await reflection.getDescriptorBySymbol(name);
    Object.assign(api, descriptor.getPackageDefinition(FORM));
  }
  return api;
}

/** A unary call as a promise. */
function call(stub, method, request) {
  return new Promise((resolve, reject) => {
    const deadline = new Date(Date.now() + 60000);
    stub[method](request, {deadline}, (error, response) =>
      error ? reject(error) : resolve(response));
  });
}

/** Every message of a call that the server streams. */
async function collect(stream) {
  const messages = [];
  for await (const message of stream) messages.push(message);
  return messages;
}

/** A wavy floor of 60 by 60 points, 50 mm apart, and a number for each. */
function makeCloud() {
  const points = [];
  for (let x = 0; x < 60; ++x) {
    for (let y = 0; y < 60; ++y) {
      points.push([50 * x - 1500, 50 * y, Math.round(20 * Math.sin(x + y))]);
    }
  }
  return {points, intensity: points.map((_, i) => i)};
}

/** The points as two blocks, back to back. */
async function uploadBytes({points, intensity}) {
  const half = points.length / 2;
  const blocks = [];
  for (const begin of [0, half]) {
    blocks.push(await writeBlock(
      STEP_NM, points.slice(begin, begin + half),
      {name: 'intensity', values: intensity.slice(begin, begin + half)}));
  }
  return Buffer.concat(blocks);
}

/** Sends all bytes; returns what the last response says is durable. */
async function write(uploads, name, bytes) {
  const stream = uploads.WriteUpload();
  for (let offset = 0; offset < bytes.length; offset += PIECE_BYTES) {
    const content = bytes.subarray(offset, offset + PIECE_BYTES);
    stream.write({name, write_offset: String(offset), data: {
      content, xxh3_64: (await checksum(content)).toString()}});
  }
  stream.end();
  return (await collect(stream)).at(-1).committed_bytes;
}

async function expectError(promise, code) {
  await assert.rejects(promise, (error) => {
    assert.equal(error.code, grpc.status[code], error.message);
    return true;
  });
}

async function main(address, how) {
  const credentials = grpc.credentials.createInsecure();
  const api = await loadApi(address, credentials, how);
  const stubs = grpc.loadPackageDefinition(api).mapsieve.v1;
  const [maps, uploads, processing, queries, operations] =
    SERVICES.map((name) => new stubs[name](address, credentials));
  const decode = (type, bytes) => api[`mapsieve.v1.${type}`].deserialize(bytes);
  const finish = async (operation, type) => {
    while (!operation.done) {
      operation = await call(operations, 'WaitOperation',
                             {name: operation.name});
    }
    assert.equal(operation.result, 'response', JSON.stringify(operation.error));
    assert.ok(operation.response.type_url.endsWith(`/mapsieve.v1.${type}`));
    return decode(type, operation.response.value);
  };

  const map = await call(maps, 'CreateMap',
                         {map_id: 'stranger', step_nm: String(STEP_NM)});
  assert.equal(map.name, 'maps/stranger');
  assert.equal(map.revision, '1');

  const cloud = makeCloud();
  const count = String(cloud.points.length);
  const bytes = await uploadBytes(cloud);
  const upload = await call(uploads, 'CreateUpload', {
    parent: map.name, upload_id: 'first', upload: {
      expected_bytes: String(bytes.length),
      content_hash: await xxhash128(bytes)}});
  assert.equal(upload.state, 'STATE_ACTIVE');
  assert.equal(await write(uploads, upload.name, bytes), String(bytes.length));
  const {report} = await finish(
    await call(uploads, 'FinalizeUpload', {name: upload.name}),
    'FinalizeUploadResponse');
  assert.equal(report.added_point_count, count);
  assert.equal(report.block_count, '2');

  const processed = await finish(
    await call(processing, 'ProcessMap', {name: map.name}),
    'ProcessMapResponse');
  assert.equal(processed.distinct_point_count, count);

  const stats = await call(maps, 'GetMapStats', {name: `${map.name}/stats`});
  assert.equal(stats.raw_point_count, count);
  assert.equal(stats.point_count, processed.point_count);
  assert.deepEqual(stats.attributes,
                   [{name: 'intensity', type: 'SCALAR_TYPE_UINT16'}]);
  const {revisions} = await call(maps, 'ListRevisions', {parent: map.name});
  assert.deepEqual(revisions.map(({kind}) => kind),
                   ['KIND_PROCESS', 'KIND_UPLOAD', 'KIND_CREATE']);

  const watched = [];
  const watching = maps.WatchMap({name: map.name, from_revision: '1'});
  for await (const {revision} of watching) {
    watched.push(revision.number);
    if (watched.length === revisions.length) break;
  }
  watching.cancel();
  assert.deepEqual(watched, ['1', '2', '3']);

  // Raw, the answer holds the very points; filtered, as many as it says of
  // them.
  const keyOf = (point, intensity) => [...point, intensity].join(' ');
  const known = new Set(
    cloud.points.map((point, i) => keyOf(point, cloud.intensity[i])));
  for (const raw of [true, false]) {
    const answer = await collect(queries.QueryRegion(
      {name: map.name, raw, plain_blocks: true}));
    assert.equal(answer[0].payload, 'header');
    const {summary} = answer.at(-1);
    assert.equal(summary.point_count, raw ? count : stats.point_count);
    const found = new Set();
    for (const {batch} of answer.slice(1, -1)) {
      const {stepNm, min, max, points, attributes} =
        await readBlock(batch.block);
      assert.equal(stepNm, STEP_NM);
      points.forEach((point, i) => {
        assert.ok(point.every((q, axis) => q >= min[axis] && q <= max[axis]));
        found.add(keyOf(point, attributes.intensity[i]));
      });
    }
    assert.equal(String(found.size), summary.point_count);
    assert.ok([...found].every((point) => known.has(point)));
  }

  // The details of an error are an RpcStatus with one ErrorInfo.
  await assert.rejects(call(maps, 'GetMap', {name: 'stranger'}), (error) => {
    assert.equal(error.code, grpc.status.INVALID_ARGUMENT);
    const [details] = error.metadata.get('grpc-status-details-bin');
    const [cause] = decode('RpcStatus', details).details;
    const info = decode('ErrorInfo', cause.value);
    assert.equal(info.reason, 'INVALID_FIELD');
    // Descriptors that came by reflection show a map as its entries.
    const facts = Array.isArray(info.metadata) ?
      Object.fromEntries(info.metadata.map(({key, value}) => [key, value])) :
      info.metadata;
    assert.equal(facts.field, 'name');
    return true;
  });

  await call(maps, 'DeleteMap', {name: map.name});
  await expectError(call(maps, 'GetMap', {name: map.name}), 'NOT_FOUND');
}

main(...process.argv.slice(2)).catch((error) => {
  console.error(error);
  process.exitCode = 1;
});
