"""The product of many small matrices with as many vectors, frequency by frequency."""

from lf_flame._common.threads import pieces, shared


def _multiply(queue, matrices, spectrum, product):
    """Multiply matrices[y, p, q, x] with spectrum[q, y, 2 x], real and imaginary parts in turn."""
    rows, planes, _, columns = matrices.shape
    for y in pieces(queue, rows):
        for p in range(planes):
            line = product[p, y]
            line[:] = 0
            for q in range(planes):
                factors, values = matrices[y, p, q], spectrum[q, y]
                for x in range(columns):
                    line[2 * x] += factors[x] * values[2 * x]
                    line[2 * x + 1] += factors[x] * values[2 * x + 1]


multiply_frequencies = shared(_multiply)
