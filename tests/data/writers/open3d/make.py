"""Makes the files beside this note: python make.py ROOM.obj FOLDER, with open3d and trimesh."""

import sys
from pathlib import Path

import open3d
import trimesh

room = trimesh.load(sys.argv[1], force="mesh", process=False)
points, triangles = (
    open3d.utility.Vector3dVector(room.vertices.copy()),
    open3d.utility.Vector3iVector(room.faces.copy()),
)
mesh = open3d.geometry.TriangleMesh(points, triangles)
mesh.compute_vertex_normals()
mesh.paint_uniform_color([1, 0, 0])
for name, text in (("room.ply", False), ("room-text.ply", True)):
    open3d.io.write_triangle_mesh(str(Path(sys.argv[2]) / name), mesh, write_ascii=text)
open3d.io.write_triangle_mesh(str(Path(sys.argv[2]) / "room.stl"), mesh)
open3d.io.write_triangle_mesh(str(Path(sys.argv[2]) / "room.off"), mesh)
