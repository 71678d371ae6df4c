"""A scene's folder by hand: a photograph, a model of three groups and a pinhole camera, never opened in earnest."""

CAMERA = """# as mrcal writes it
{{ 'lensmodel': '{lens}', 'intrinsics': [ 100., 100., 1.5, 1.5 ],
   'extrinsics': [ 0., 0., 0., 0., 0., 0. ], 'imagersize': [ 4, 4 ] }}
"""


def attic(tmp_path):
    """A scene with a photograph, a model of three groups and a pinhole camera (never opened in earnest here)."""
    folder = tmp_path / "attic"
    folder.mkdir()
    (folder / "left.png").write_bytes(b"\x89PNG")
    (folder / "model.obj").write_text(
        "mtllib model.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl wall\nf 1 2 3\n"
        "usemtl lamp \nf 1 2 3\r\n  usemtl light box\r\nf 1 2 3\n"
    )
    (folder / "left.posed.cameramodel").write_text(CAMERA.format(lens="LENSMODEL_PINHOLE"))
    return folder
