"""TEMPORARY: stand-ins for agglo_core.multigrid.block_matrix, scalar_gauss_seidel and aggregation.

To be deleted when those are merged; the names are theirs.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numba as nb
import numpy as np
from scipy import sparse

from agglo_core.authoring import Level, LevelStack


@cache
def _block_kernels(n):
    @nb.njit(fastmath=True)
    def invert(ip, ix, dat, out):
        D = np.empty((n, n))
        for i in range(len(ip) - 1):
            for k in range(ip[i], ip[i + 1]):
                if ix[k] == i:
                    for a in range(n):
                        for b in range(n):
                            D[a, b] = dat[k, a, b]
            for a in range(n):
                p = 1.0 / D[a, a]
                for c in range(n):
                    D[a, c] *= p
                D[a, a] = p
                for r in range(n):
                    if r != a:
                        t = D[r, a]
                        D[r, a] = 0.0
                        for c in range(n):
                            D[r, c] -= t * D[a, c]
            for a in range(n):
                for b in range(n):
                    out[i, a, b] = D[a, b]

    @nb.njit(fastmath=True)
    def low(ip, ix, dT, Di, x, b):
        bb = np.empty(n, x.dtype)
        for i in range(len(ip) - 1):
            for q in range(n):
                bb[q] = b[i * n + q]
            for k in range(ip[i], ip[i + 1]):
                if ix[k] >= i:
                    break
                o = ix[k] * n
                for c in range(n):
                    xc = x[o + c]
                    for q in range(n):
                        bb[q] -= dT[k, c, q] * xc
            o2 = x[i * n : (i + 1) * n]
            for q in range(n):
                o2[q] = 0
            for c in range(n):
                t = bb[c]
                for q in range(n):
                    o2[q] += Di[i, c, q] * t

    @nb.njit(fastmath=True)
    def up(ip, ix, dT, x, r):
        for i in range(len(ip) - 1):
            bb = r[i * n : (i + 1) * n]
            for q in range(n):
                bb[q] = 0
            for k in range(ip[i + 1] - 1, ip[i] - 1, -1):
                if ix[k] <= i:
                    break
                o = ix[k] * n
                for c in range(n):
                    xc = x[o + c]
                    for q in range(n):
                        bb[q] -= dT[k, c, q] * xc

    @nb.njit(fastmath=True)
    def back(ip, ix, dT, Di, x, b):
        bb = np.empty(n, x.dtype)
        for i in range(len(ip) - 2, -1, -1):
            for q in range(n):
                bb[q] = b[i * n + q]
            for k in range(ip[i], ip[i + 1]):
                o = ix[k] * n
                for c in range(n):
                    xc = x[o + c]
                    for q in range(n):
                        bb[q] -= dT[k, c, q] * xc
            for c in range(n):
                t = bb[c]
                for q in range(n):
                    x[i * n + q] += Di[i, c, q] * t

    return invert, low, up, back


class BlockGaussSeidel:
    def __init__(self, A: Any, block_offsets: Any, dtype: Any) -> None:
        n = A.blocksize[0]
        N = A.shape[0] // n
        invert, self.low, self.up, self.back = _block_kernels(n)
        self.ip, self.ix = A.indptr.astype(np.int32), A.indices.astype(np.int32)
        self.dT = _clean(A.data.swapaxes(1, 2).astype(dtype, order="C"))
        self.Di = np.empty((N, n, n), dtype)
        invert(self.ip, self.ix, A.data, self.Di)
        _clean(self.Di)

    def before(self, b):
        x, r = np.empty_like(b), np.empty_like(b)
        self.low(self.ip, self.ix, self.dT, self.Di, x, b)
        self.up(self.ip, self.ix, self.dT, x, r)
        return x, r

    def after(self, b, x):
        self.back(self.ip, self.ix, self.dT, self.Di, x, b)
        return x


@nb.njit(cache=True)
def _clean_(f, t):
    for i in range(len(f)):
        if abs(f[i]) < t:
            f[i] = 0


def _clean(X):
    f = X.reshape(-1)
    _clean_(f, 1e-22 * float(max(f.max(), -f.min())))
    return X


@nb.njit(fastmath=True, inline="always")
def _dot(ix, a, x, k0, k1):
    t0 = a[0] * 0
    t1 = t0
    t2 = t0
    t3 = t0
    k = k0
    while k + 3 < k1:
        t0 += a[k] * x[ix[k]]
        t1 += a[k + 1] * x[ix[k + 1]]
        t2 += a[k + 2] * x[ix[k + 2]]
        t3 += a[k + 3] * x[ix[k + 3]]
        k += 4
    while k < k1:
        t0 += a[k] * x[ix[k]]
        k += 1
    return (t0 + t1) + (t2 + t3)


@nb.njit(cache=True, fastmath=True)
def _first(ip, dp, ix, a, di, b, x, r):
    n = len(ip) - 1
    for i in range(n):
        x[i] = (b[i] - _dot(ix, a, x, ip[i], dp[i])) * di[i]
    for i in range(n):
        r[i] = -_dot(ix, a, x, dp[i] + 1, ip[i + 1])


@nb.njit(cache=True, fastmath=True)
def _backward(ip, ix, a, di, x, b):
    for i in range(len(ip) - 2, -1, -1):
        x[i] += (b[i] - _dot(ix, a, x, ip[i], ip[i + 1])) * di[i]


class ScalarGaussSeidel:
    def __init__(self, A: Any, dtype: Any) -> None:
        self.ip, self.ix, self.a = A.indptr, A.indices, A.data.astype(dtype)
        self.di = (1 / A.diagonal()).astype(dtype)
        row = np.repeat(np.arange(A.shape[0]), np.diff(A.indptr))
        self.dp = np.flatnonzero(A.indices == row)

    def before(self, b):
        x, r = np.empty_like(b), np.empty_like(b)
        _first(self.ip, self.dp, self.ix, self.a, self.di, b, x, r)
        return x, r

    def after(self, b, x):
        _backward(self.ip, self.ix, self.a, self.di, x, b)
        return x


@nb.njit(cache=True)
def _aggregate(ip, ix, a, d, theta):
    n = len(ip) - 1
    lab = np.full(n, -1, np.int32)
    na = 0
    for i in range(n):
        if lab[i] >= 0:
            continue
        ok = True
        cnt = 0
        for k in range(ip[i], ip[i + 1]):
            j = ix[k]
            if j != i and -a[k] > theta * np.sqrt(d[i] * d[j]):
                cnt += 1
                if lab[j] >= 0:
                    ok = False
                    break
        if ok and cnt > 0:
            lab[i] = na
            for k in range(ip[i], ip[i + 1]):
                j = ix[k]
                if j != i and -a[k] > theta * np.sqrt(d[i] * d[j]):
                    lab[j] = na
            na += 1
    l2 = lab.copy()
    for i in range(n):
        if lab[i] >= 0:
            continue
        best = 0.0
        bj = -1
        for k in range(ip[i], ip[i + 1]):
            j = ix[k]
            if j != i and lab[j] >= 0:
                s = -a[k] / np.sqrt(d[i] * d[j])
                if s > best:
                    best = s
                    bj = j
        if bj >= 0 and best > 0.25 * theta:
            l2[i] = lab[bj]
    for i in range(n):
        if l2[i] < 0:
            l2[i] = na
            for k in range(ip[i], ip[i + 1]):
                j = ix[k]
                if l2[j] < 0 and -a[k] > theta * np.sqrt(d[i] * d[j]):
                    l2[j] = na
            na += 1
    return l2, na


@nb.njit(cache=True)
def _filtered(ip, ix, a, d, theta):
    n = len(ip) - 1
    op = np.zeros(n + 1, np.int64)
    oi = np.empty(len(ix), np.int32)
    oa = np.empty(len(ix))
    pos = 0
    for i in range(n):
        s = 0.0
        dp = -1
        for k in range(ip[i], ip[i + 1]):
            j = ix[k]
            if j == i:
                dp = pos
                oi[pos] = j
                oa[pos] = a[k]
                pos += 1
            elif abs(a[k]) > theta * d[i]:
                oi[pos] = j
                oa[pos] = a[k]
                pos += 1
            else:
                s += a[k]
        if oa[dp] + s > 0.1 * oa[dp]:
            oa[dp] += s
        op[i + 1] = pos
    return op, oi[:pos], oa[:pos]


def aggregation_stack(A, *, labels=None, dtype=np.float64, theta=0.06, coarsest=500):
    levels = []
    C = sparse.csr_matrix(A)
    while C.shape[0] > coarsest:
        C.sort_indices()
        d, n = C.diagonal(), C.shape[0]
        if labels is not None and not levels:
            lab, na = labels[0], labels[0].max() + 1
        else:
            lab, na = _aggregate(C.indptr, C.indices, C.data, d, theta * 0.5 ** len(levels))
        if na > 0.7 * n:
            lab, na = _aggregate(C.indptr, C.indices, C.data, d, 0.0)
            if na > 0.7 * n:
                break
        fo, fi, fa = _filtered(C.indptr, C.indices, C.data, d, 0.01)
        F = sparse.csr_matrix((fa, fi, fo), shape=C.shape)
        fd = F.diagonal()
        lm = np.max(np.add.reduceat(np.abs(F.data), F.indptr[:-1]) / fd)
        v = np.random.default_rng(0).standard_normal(n)
        for _ in range(8):
            v /= np.linalg.norm(v)
            v = (F @ v) / fd
        lm = min(lm, 1.1 * np.linalg.norm(v))
        T = sparse.csr_matrix((np.ones(n), lab, np.arange(n + 1)), shape=(n, na))
        P = (T - sparse.diags((4 / 3) / lm / fd) @ (F @ T)).tocsr()
        Cc = (P.T.tocsr() @ (C @ P)).tocsr()
        levels.append(Level(C.astype(dtype), np.arange(n + 1), P.astype(dtype), ScalarGaussSeidel(C, dtype)))
        C = Cc
    M = C.toarray()
    q = 1 / np.sqrt(M.diagonal())
    M = M * q[:, None] * q
    M[np.diag_indices_from(M)] += 1e-13
    inverse = (np.linalg.inv(M) * q[:, None] * q).astype(dtype)
    levels.append(Level(C.astype(dtype), np.arange(C.shape[0] + 1)))
    return LevelStack(levels, lambda b: inverse @ b, dtype)
