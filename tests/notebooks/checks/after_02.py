"""What the cells of notebook 02 leave is what its text says."""

import numpy as np


def after_02_05(beta, fit):
    np.testing.assert_allclose(fit.ratio, beta, rtol=1e-12)


def after_02_05b(by_the_page, fast, p, paper, q):
    np.testing.assert_allclose(by_the_page, fast.ratio, atol=1e-3)
    np.testing.assert_allclose(paper.risk(fast.ratio, p, q), fast.objective, rtol=1e-12)


def after_02_07(bounds, divergence, fit):
    plain, normalised = (np.array(bound) for bound in bounds.values())
    assert (plain <= normalised + 1e-12).all()
    assert (normalised <= divergence + 1e-12).all()
    assert abs(fit.divergence - divergence) < 1e-12


def after_02_09(beta, clipped, fit, q):
    np.testing.assert_allclose(clipped.ratio, np.clip(beta, 0.5, 2.0))
    np.testing.assert_allclose(q @ fit.ratio, 1.0)


def after_02_11(dual, eta, fit):
    assert max(dual(e) for e in eta) <= fit.objective + 1e-12  # no price proves more
    np.testing.assert_allclose(dual(fit.normalizer), fit.objective, atol=1e-12)


def after_02_13(fit, general):
    assert np.abs(general.ratio - fit.ratio).max() < 1e-4


def after_02_19(fits, q):
    assert q @ fits["towards 0"][-1].ratio < 0.05
    np.testing.assert_allclose(
        fits["towards 0, normalised"][-1].ratio, q / (q @ q), atol=0.1
    )
    np.testing.assert_allclose(
        [q @ f.ratio for f in fits["towards 1, normalised"]], 1.0
    )


def after_02_28(by_hand, row, zeta):
    np.testing.assert_allclose(by_hand, zeta.values[[row]].data)
    assert zeta.gap < 1e-8
    assert zeta.row_sum_error < 1e-12


def after_02_21(found, spread, theory):
    for name in spread:
        np.testing.assert_allclose(found[name], theory[name], rtol=0.2)
