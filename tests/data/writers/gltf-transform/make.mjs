// node make.mjs ROOM.glb FOLDER: needs @gltf-transform/core, extensions, functions, meshoptimizer
import { NodeIO } from '@gltf-transform/core';
import { ALL_EXTENSIONS, KHRMeshQuantization, EXTMeshoptCompression, KHRMaterialsVariants } from '@gltf-transform/extensions';
import { quantize, instance, dedup, join, sparse, meshopt, reorder, flatten, weld } from '@gltf-transform/functions';
import { MeshoptDecoder, MeshoptEncoder } from 'meshoptimizer';
await MeshoptEncoder.ready;
const [room, out] = process.argv.slice(2);
const io = new NodeIO().registerExtensions(ALL_EXTENSIONS).registerDependencies({ 'meshopt.decoder': MeshoptDecoder, 'meshopt.encoder': MeshoptEncoder });
const read = () => io.read(room);
let doc = await read();
await doc.transform(quantize({ quantizePosition: 14 }));
await io.write(`${out}/quantized.glb`, doc);
doc = await read();
await doc.transform(quantize({ quantizePosition: 8, quantizationVolume: 'scene' }));
await io.write(`${out}/quantized-scene.glb`, doc);
doc = await read();
await doc.transform(meshopt({ encoder: MeshoptEncoder }));
await io.write(`${out}/meshopt.glb`, doc);
// sparse: the crate's corners that are not at the origin of a moved mesh
doc = await read();
for (const mesh of doc.getRoot().listMeshes()) for (const p of mesh.listPrimitives()) p.getAttribute('POSITION').setSparse(true);
await io.write(`${out}/sparse.glb`, doc);
// instances: four chairs share a mesh
doc = await io.read(process.argv[4]);
await doc.transform(dedup(), instance({ min: 2 }));
await io.write(`${out}/instanced.glb`, doc);
await doc.transform(quantize({ quantizePosition: 16 }));
await io.write(`${out}/instanced-quantized.glb`, doc);
