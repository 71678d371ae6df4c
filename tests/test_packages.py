"""Heavy packages without the parts that draw."""


def test_open3d_casts_without_its_windows(run):
    """What is left out cannot be missed by rays, and who asks for it later gets it."""
    done = run(
        "-c",
        "from lib.core import packages\n"
        "import sys\n"
        "o3d = packages.open3d()\n"
        "assert packages.open3d() is o3d\n"
        "assert 'open3d.visualization' not in sys.modules\n"
        "scene = o3d.t.geometry.RaycastingScene()\n"
        "corners = o3d.core.Tensor([[0, 0, 1], [1, 0, 1], [0, 1, 1]], o3d.core.float32)\n"
        "scene.add_triangles(corners, o3d.core.Tensor([[0, 1, 2]], o3d.core.uint32))\n"
        "hits = scene.cast_rays(o3d.core.Tensor([[0.2, 0.2, 0, 0, 0, 1]], o3d.core.float32))\n"
        "print(f'{hits[\"t_hit\"].item():.6f}')\n",
    )
    assert (done.stdout, done.stderr) == ("1.000000\n", "")


def test_colour_differs_as_published_without_its_plots(run):
    """The first pair of Sharma, Wu and Dalal (2005): CIEDE2000 = 2.0425."""
    done = run(
        "-c",
        "from lib.core import packages\n"
        "import sys\n"
        "difference = packages.colour().delta_E([50, 2.6772, -79.7751], [50, 0, -82.7485], method='CIE 2000')\n"
        "assert 'matplotlib' not in sys.modules\n"
        "print(f'{difference:.4f}')\n",
    )
    assert (done.stdout, done.stderr) == ("2.0425\n", "")


def test_numba_finds_blas_without_the_rest_of_scipy_linalg(run):
    """What imports scipy.linalg later gets all of it."""
    done = run(
        "-c",
        "import sys\n"
        "import numpy as np\n"
        "from lib.core import compiled\n"
        "import numba\n"
        "product = numba.njit(lambda a, b: np.dot(a, b))(np.array([1.0, 2.0]), np.array([3.0, 4.0]))\n"
        "assert 'scipy.linalg' not in sys.modules\n"
        "import scipy.linalg\n"
        "print(product, scipy.linalg.det([[2.0, 0.0], [0.0, 3.0]]))\n",
    )
    assert (done.stdout, done.stderr) == ("11.0 6.0\n", "")
