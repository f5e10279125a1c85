"""Loop closure: find landmarks, built from tracks at different times, that are the same, and joins that are wrong.

Most of the error of landmarks is common to all that were seen at one time, so the distance of a pair is measured in
sigmas of their difference, by the joint covariance of the smoother. Pairs whose difference is vague must agree on how
far it has moved [Neira, Tardós 2001]: each pair taken is a measurement of its own difference, which changes what the
others should be, as in a Kalman filter. Where another set explains nearly as many pairs, neither is chosen.

A wrong loop bends the poses until its bearings fit, so that their residuals stay small, but the gradient of the cost at
this visit is large: it tells where a landmark of its own would be, and how far the cost would fall [Rao 1948].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.mapping.factors import (
    CONSTANTS,
    Prior,
    Problem,
    State,
    Steps,
    bearing_block,
    variables,
    wheel_residuals,
)
from localiser.mapping.landmarks import Built
from localiser.mapping.sightings import Index
from localiser.mapping.smooth import Smoothed, halved
from localiser.mapping.tracks import looks_alike

# -- joint compatibility ----------------------------------------------------------------------------------------------

Mask = NDArray[np.bool_]

_GATE = 11.8  # 99.7 % of a Gaussian in the plane
_CLEARLY = 1.4  # so many times as many pairs must speak for one set as for another one


def compatible(difference: Array, cov: Array, noise_m: float) -> Mask:
    """Return which pairs (P,) are one: the largest set that agrees, without what another set explains nearly as well.

    difference: (P, 2) m. cov: (2 P, 2 P) m² of all differences. noise_m: sigma by which two sightings of one thing
    differ.
    """
    sets: list[Mask] = []
    for seed in range(len(difference)):
        # A pair of a set that was found grows the same set or one that is nearly the same.
        if not any(found[seed] for found in sets):
            sets.append(_grow(seed, difference, cov, noise_m))
    kept = best = max(sets, key=lambda found: int(found.sum()), default=np.zeros(0, dtype=bool))
    for other in sets:
        contrary = best & ~other
        if _CLEARLY * (other & ~best).sum() > contrary.sum():
            kept = kept & ~contrary
    return kept


def _grow(seed: int, difference: Array, cov: Array, noise_m: float) -> Mask:
    """Return the pairs (P,) that agree with the pair `seed` and with each other; those that agree best come first.

    Each pair taken is a measurement of its own difference. What it tells of all others is a factor (2 P, 2): the
    covariance that is left is `cov` less the sum of factor · factorᵀ. Of it, only what is asked for is computed.
    """
    count = len(difference)
    chosen, fits = np.zeros(count, dtype=bool), np.ones(count, dtype=bool)
    mean, factors, noise = difference.ravel().copy(), np.zeros((2 * count, 2 * count)), noise_m**2 * np.eye(2)
    own_cov = cov.reshape(count, 2, count, 2)[np.arange(count), :, np.arange(count)] + noise
    pair = seed
    for taken in range(0, 2 * count, 2):
        own = slice(2 * pair, 2 * pair + 2)
        with_all = cov[:, own] - factors[:, :taken] @ factors[own, :taken].T
        whitening = np.linalg.inv(np.linalg.cholesky(with_all[own] + noise)).T
        factor = with_all @ whitening
        mean -= factor @ (whitening.T @ mean[own])
        factors[:, taken : taken + 2] = factor
        of_pair = factor.reshape(count, 2, 2)
        own_cov -= of_pair @ of_pair.transpose(0, 2, 1)
        chosen[pair] = True
        (x, z), (xx, xz, zz) = mean.reshape(count, 2).T, (own_cov[:, 0, 0], own_cov[:, 0, 1], own_cov[:, 1, 1])
        chi2 = (zz * x**2 - 2 * xz * x * z + xx * z**2) / (xx * zz - xz**2)
        fits &= (chi2 < _GATE) & ~chosen
        if not fits.any():
            break
        pair = int(np.where(fits, chi2, np.inf).argmin())
    return chosen


# -- loop closure -----------------------------------------------------------------------------------------------------

_LEAST_SIGMA_M = 0.004  # no two sightings of one edge stand closer
_FARTHEST_SIGMA_M = 0.25  # a difference less certain than this joins anything
_UNLIKE = 0.0  # log-likelihood ratio of looks below which two are not one
_TOGETHER_SHARE = 0.1  # of the frames of the rarer one, in which another edge may have been taken for the other
_CONTRARY = -3.0  # log-likelihood ratio of one edge being seen with either sign
_CERTAIN_SIGMA_M = 0.02  # a difference known as well as this tells two edges by their places
_KNOWN_SIGMA_M = 0.01  # as well as this, it tells them whatever others say
_OUTVOTED = 0.5  # mean weight below which a track does not fit its landmark
_MOST_PAIRS = 300  # of one place, that are compared with each other
_PLACE_M = 4.0  # side of a place that is not divided further
_AMBIGUOUS = 2.0  # log-likelihood by which a pair must beat every other pair of its landmarks


def same_landmarks(smoothed: Smoothed, built: Built, frame: Index) -> Index:
    """Return for each landmark (L) the number of the one that it is the same as; its own where there is none.

    smoothed: their places, and the joint covariance of these. built: how they look. frame: (K,) of the sightings used;
    two that are often seen in one frame are two. Polarities that contradict each other do not part what stands at one
    place for certain: the sign of an edge depends on what lies behind it.
    """
    from scipy.sparse import csc_array

    points, count = smoothed.points, len(smoothed.points)
    one, other = _near(points, np.flatnonzero(built.parallax >= np.deg2rad(3.0)))
    if len(one) == 0:
        return np.arange(count)
    looks = looks_alike(built.side[one], built.polarity[one], built.side[other], built.polarity[other])
    contrary = np.isneginf(looks)
    shown = csc_array((np.ones(len(frame)), (frame, built.of[built.used])), dtype=np.int64)
    shown.data[:] = 1  # however often in one frame
    both = (shown.T @ shown).tocsr()
    fewer, together = np.minimum(both[one, one], both[other, other]), both[one, other]
    may = (together <= np.maximum(_TOGETHER_SHARE * fewer, 1)) & ((looks >= _UNLIKE) | contrary)
    # However two landmarks are correlated, the covariance of their difference is at most twice the sum of their own.
    single, reach = smoothed.landmark_cov(), points[one[may]] - points[other[may]]
    most = 2 * (single[one[may]] + single[other[may]]) + _LEAST_SIGMA_M**2 * np.eye(2)
    may[may] = np.einsum("pi,pij,pj->p", reach, np.linalg.inv(most), reach) < _GATE
    one, other, looks, contrary = one[may], other[may], np.where(contrary, _CONTRARY, looks)[may], contrary[may]
    apart = points[one] - points[other]
    cov = smoothed.difference_cov(one, other) + _LEAST_SIGMA_M**2 * np.eye(2)
    chi2 = np.einsum("pi,pij,pj->p", apart, np.linalg.inv(cov), apart)
    sigma = np.sqrt(np.linalg.eigvalsh(cov)[:, 1])
    fit = (chi2 < _GATE) & (sigma < np.where(contrary, _CERTAIN_SIGMA_M, _FARTHEST_SIGMA_M))
    one, other, chi2, sigma, looks = one[fit], other[fit], chi2[fit], sigma[fit], looks[fit]
    # How much likelier it is that they are one than that the second is any other edge that happens to stand here.
    score = looks - 0.5 * chi2 - np.log(sigma)
    # Where places are known so well, no drift is left on which pairs would have to agree.
    agree = sigma < _KNOWN_SIGMA_M
    vague = np.flatnonzero(~agree)
    for near in _places(((points[one] + points[other]) / 2)[vague], score[vague]):
        place = vague[near]
        joint = smoothed.joint_difference_cov(one[place], other[place])
        agree[place] = compatible((points[one] - points[other])[place], joint, _LEAST_SIGMA_M)
    one, other, sigma, score = one[agree], other[agree], sigma[agree], score[agree]
    clear = np.flatnonzero(_clear(one, other, score, count))
    clear = clear[np.argsort(sigma[clear], kind="stable")]
    return _unite(one, other, clear, count)


def without_outvoted_tracks(built: Built, weight: Array, track: Index) -> Index:
    """Return the landmarks (S,) of the sightings with the tracks that do not fit theirs as landmarks of their own.

    weight: (K,) of the bearings used, by the robust cost: where a track as a whole is outvoted, it was joined wrongly.
    track: (S,) as followed.
    """
    used, landmark = built.used, built.of[built.used]
    tracks = int(track.max(initial=-1)) + 2
    part, index = np.unique(landmark * tracks + track[used] + 1, return_inverse=True)
    owner, followed = part // tracks, part % tracks > 0
    count = np.bincount(index)
    fits = np.bincount(index, weight) > _OUTVOTED * count
    several = np.bincount(owner, minlength=len(built))[owner] > 1
    leaves = (several & ~fits & followed)[index]
    of = built.of.copy()
    of[used[leaves]] = len(built) + index[leaves]
    return of


def _near(points: Array, known: Index) -> tuple[Index, Index]:
    """Return the pairs (P,) of known landmarks that are near enough to be one."""
    from scipy.spatial import cKDTree

    reach = np.sqrt(_GATE) * _FARTHEST_SIGMA_M
    pairs = cKDTree(points[known]).query_pairs(reach, output_type="ndarray").reshape(-1, 2)
    return known[pairs[:, 0]], known[pairs[:, 1]]


def _places(middle: Array, score: Array) -> list[Index]:
    """Return the pairs (K,) of each place, few enough to be compared with each other; middle (P, 2), score (P,) of all.

    Too many are divided at their median, into pairs of two places. In a place that is small the likeliest are taken.
    """
    likely = np.argsort(-score, kind="stable")
    place = middle[likely]

    def is_small(part: Index) -> bool:
        return len(part) <= _MOST_PAIRS or bool(np.ptp(place[part], axis=0).max() <= _PLACE_M)

    return [likely[part[:_MOST_PAIRS]] for part in halved(place, is_small)]


def _partners(one: Index, other: Index, count: int) -> list[set[int]]:
    """Return for each landmark (L) those that it may be one with."""
    partners: list[set[int]] = [set() for _ in range(count)]
    for i, j in zip(one.tolist(), other.tolist(), strict=True):
        partners[i].add(j)
        partners[j].add(i)
    return partners


def _clear(one: Index, other: Index, score: Array, count: int) -> NDArray[np.bool_]:
    """Return which pairs (P,) have no alternative hypothesis: no other pair of either landmark is nearly as likely.

    A third landmark that may be one with both is no alternative: all three may be one.
    """
    partners = _partners(one, other, count)
    value = {frozenset(pair): v for *pair, v in zip(one.tolist(), other.tolist(), score.tolist(), strict=True)}
    clear = np.ones(len(one), dtype=bool)
    for index, (i, j) in enumerate(zip(one.tolist(), other.tolist(), strict=True)):
        least = score[index] - _AMBIGUOUS
        alternatives = [(i, k) for k in partners[i] - partners[j] - {j}] + [
            (j, k) for k in partners[j] - partners[i] - {i}
        ]
        clear[index] = all(value[frozenset(pair)] < least for pair in alternatives)
    return clear


def _unite(one: Index, other: Index, order: Index, count: int) -> Index:
    """Return for each landmark (L) the first of those it is one with; all of which may be one with each other.

    order: the pairs (P,) to unite, as long as that holds.
    """
    partners = _partners(one, other, count)
    members = {index: {index} for index in range(count)}
    number = np.arange(count)
    for i, j in zip(one[order].tolist(), other[order].tolist(), strict=True):
        first, second = sorted((int(number[i]), int(number[j])))
        if first == second or not all(members[second] <= partners[k] for k in members[first]):
            continue
        members[first] |= members.pop(second)
        number[list(members[first])] = first
    return number


# -- the score test ---------------------------------------------------------------------------------------------------

_LEAST_VISIT_SIGMA_M = 0.008  # from its other side, an edge is the other side of a frame or a strip
_APART_FRAMES = 30  # without a landmark, after which it is visited again


def without_contradicting_visits(problem: Problem, smoothed: Smoothed, of: Index, used: Index) -> Index:
    """Return the landmarks `of` (S,) with the visits that contradict their landmarks as landmarks of their own.

    used: (K,) the sightings that are the bearings of the problem. Of visits at one time only the worst leaves: it may
    be why the others seem to contradict.
    """
    landmark = problem.bearings.landmark
    visit = visits(landmark, problem.bearings.frame)
    owner = np.zeros(visit.max(initial=-1) + 1, dtype=np.int64)
    owner[visit] = landmark
    several = np.flatnonzero(np.bincount(owner)[owner] > 1)
    if len(several) == 0:
        return of
    chi2 = visit_contradiction(problem, smoothed, visit, several)
    taken = np.zeros(int(problem.bearings.frame.max()) + 1, dtype=bool)
    leaving = []
    for index in np.argsort(-chi2, kind="stable")[: (chi2 > _GATE).sum()]:
        frames = problem.bearings.frame[visit == several[index]]
        if not taken[frames.min() : frames.max() + 1].any():
            taken[frames.min() : frames.max() + 1] = True
            leaving.append(several[index])
    parted = of.copy()
    gone = np.isin(visit, leaving)
    parted[used[gone]] = len(smoothed.points) + visit[gone]
    return parted


def visits(landmark: Index, frame: Index) -> Index:
    """Return the number (K,) of the visit that each bearing belongs to: a landmark's sightings without a long pause."""
    order = np.lexsort((frame, landmark))
    begins = (np.diff(landmark[order]) != 0) | (np.diff(frame[order]) > _APART_FRAMES)
    visit = np.zeros(len(landmark), dtype=np.int64)
    visit[order[1:]] = np.cumsum(begins)
    return visit


def visit_contradiction(problem: Problem, smoothed: Smoothed, visit: Index, asked: Index) -> Array:
    """Return for each visit `asked` (V,) how many squared sigmas its own landmark would stand from the present one.

    With cost(δ) = cost - 2 λᵀδ + δᵀMδ for a landmark of its own at distance δ, all else at its best: λ is the pull of
    the visit's bearings, M their information less what poses and landmark take up. visit: (K,).
    """
    from scipy.sparse import csc_array

    state = State(smoothed.poses, smoothed.points, smoothed.constants, smoothed.points)
    bearing = bearing_block(problem, state)
    number = np.full(int(visit.max(initial=-1)) + 1, -1)
    number[asked] = np.arange(len(asked))
    kept = np.flatnonzero(number[visit] >= 0)
    own, shift = number[visit[kept]], bearing.value[kept, 3:5]
    weighted = bearing.weight[kept, None] * shift
    pull, information = np.zeros((len(asked), 2)), np.zeros((len(asked), 2, 2))
    np.add.at(pull, own, weighted * bearing.residual[kept, None])
    np.add.at(information, own, weighted[:, :, None] * shift[:, None])
    # Moving a visit's landmark, (K, 2 V), and what that asks of all variables of the problem.
    entries = weighted.ravel(), (np.repeat(np.arange(len(kept)), 2), (2 * own[:, None] + np.arange(2)).ravel())
    by_visit = csc_array(entries, shape=(len(kept), 2 * len(asked)))
    asks = bearing.jacobian(variables(state))[kept].T @ by_visit
    # A visit that tells one direction only has no information along the other.
    known, axes = np.linalg.eigh(information - smoothed.factor.projected(asks.tocsc()))
    variance = 1 / np.maximum(known, 1e-6) + _LEAST_VISIT_SIGMA_M**2
    offset = np.einsum("vji,vj->vi", axes, pull) / np.maximum(known, 1e-6)
    return np.asarray(np.where(known > 1e-3, offset**2 / variance, 0.0).sum(axis=1))


# -- the wheels -------------------------------------------------------------------------------------------------------

_CONSTANTS_CHI2 = 16.3  # 99.7 % of a Gaussian of four dimensions
_STRETCHES = (1, 10, 30, 100)  # steps between images, over which the noise is compared
_CHANCE = 0.003  # that the noise of right wheels alone contradicts a path


def contradicting_steps(wheels: Steps, poses: Array, constants: Array) -> Index:
    """Return the steps (K,), each from image k to k + 1, in which a path contradicts the wheels."""
    chi2 = (wheel_residuals(wheels, poses, constants) ** 2).sum(axis=1)
    return np.flatnonzero(chi2 > _largest_chi2(len(chi2)))


def contradiction(wheels: Steps, prior: Prior, poses: Array, constants: Array) -> str | None:
    """Return in words how a path contradicts the wheels; None where it does not.

    poses: (T, 3). constants: (4,) of wheels and mount, as in `factors.CONSTANTS`. prior: what is stated of them.
    """
    sigmas = (constants - prior.mean) / prior.sigma
    if sigmas @ sigmas > _CONSTANTS_CHI2:
        worst = int(np.abs(sigmas).argmax())
        return f"the wheels' constant errors would be {abs(sigmas[worst]):.1f} sigmas off ({CONSTANTS[worst]})"
    residual = wheel_residuals(wheels, poses, constants)
    gate = _largest_chi2(len(residual))
    for steps in _STRETCHES:
        count = len(residual) // steps
        sums = residual[: count * steps].reshape(count, steps, 3).sum(axis=1)
        chi2 = (sums**2).sum(axis=1) / steps
        if count and chi2.max() > gate:
            first = int(chi2.argmax()) * steps
            return f"the wheels would be {np.sqrt(chi2.max()):.1f} sigmas off from image {first} to {first + steps}"
    return None


def _largest_chi2(count: int) -> float:
    """Return what the largest χ² of `count` Gaussians of three dimensions exceeds with the probability `_CHANCE`.

    The longer the drive, the farther off the noise of its worst step.
    """
    from scipy.special import chdtri

    return float(chdtri(3, _CHANCE / max(count, 1)))
