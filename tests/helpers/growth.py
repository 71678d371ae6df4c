"""How the cost of a call grows with its input: the same machine, the same minute, so that its speed does not matter."""

import time

REPEATS = 3


def growth(small, large) -> float:
    """CPU time of large() over that of small(): the least of three each, in turns, after one call of both."""
    small(), large()
    least = [float("inf"), float("inf")]
    for _ in range(REPEATS):
        for which, call in enumerate((small, large)):
            begin = time.process_time()
            call()
            least[which] = min(least[which], time.process_time() - begin)
    return least[1] / max(least[0], 1e-9)
