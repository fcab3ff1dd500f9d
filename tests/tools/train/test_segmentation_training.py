from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

torch = pytest.importorskip("torch", reason="the extra 'train' is not installed")

from tools.train.salsanext import SalsaNext  # noqa: E402
from tools.train.segmentation_loss import (  # noqa: E402
    SMALLEST_ERROR,
    class_weights,
    cross_entropy,
    lovasz_gradient,
    lovasz_softmax,
)
from tools.train.segmenter import (  # noqa: E402
    LabeledScan,
    ScanSegmenter,
    mirrored_scan,
    turned_scan,
)


def iou_loss(truth: np.ndarray, wrong: np.ndarray) -> float:
    """1 - IoU where `wrong` marks the mistakes."""
    said = truth ^ wrong
    union = (truth | said).sum()
    return 1 - (truth & said).sum() / union if union else 0.0


@given(st.lists(st.booleans(), min_size=1, max_size=10).filter(any))
def test_the_lovasz_gradient_adds_up_to_what_the_first_errors_cost(truth: list[bool]) -> None:
    known = np.array(truth)
    errors = torch.tensor(truth, dtype=torch.float32)
    gradient = lovasz_gradient(errors, errors.sum()).numpy()
    for count in range(1, len(truth) + 1):
        wrong = np.arange(len(truth)) < count
        assert gradient[:count].sum() == pytest.approx(iou_loss(known, wrong), abs=1e-5)


def test_hard_answers_cost_one_minus_the_mean_iou() -> None:
    labels = torch.tensor([[[1, 1, 2, 2], [2, 2, 0, 1]]])
    said = torch.tensor([[[1, 2, 2, 2], [2, 1, 1, 1]]])
    logits = 50.0 * torch.nn.functional.one_hot(said, 3).movedim(-1, 1).float()
    # Of class 1: two of four; of class 2: three of five. The cell without truth does not count.
    assert float(lovasz_softmax(logits, labels)) == pytest.approx(1 - (2 / 4 + 3 / 5) / 2, abs=1e-4)


def test_an_image_without_truth_costs_nothing() -> None:
    logits = torch.randn(1, 4, 3, 3, requires_grad=True)
    empty = torch.zeros(1, 3, 3, dtype=torch.int64)
    weights = class_weights([0, 1, 1, 1])
    loss = lovasz_softmax(logits, empty) + cross_entropy(logits, empty, weights)
    loss.backward()
    assert float(loss.detach()) == 0


@given(st.integers(0, 2**32 - 1))
def test_small_errors_are_left_out_for_next_to_nothing(seed: int) -> None:
    random = torch.Generator().manual_seed(seed)
    logits = 5 * torch.randn(1, 4, 6, 8, generator=random)
    labels = torch.randint(1, 4, (1, 6, 8), generator=random)
    probability = logits.softmax(dim=1).movedim(1, -1).reshape(-1, 4)
    whole = []
    for label in labels.unique():
        is_it = (labels.flatten() == label).float()
        error, order = (is_it - probability[:, label]).abs().sort(descending=True)
        whole.append(float((error * lovasz_gradient(is_it[order], is_it.sum())).sum()))
    quick = float(lovasz_softmax(logits, labels))
    assert 0 <= np.mean(whole) - quick + 1e-6 <= SMALLEST_ERROR + 2e-6


def test_rare_classes_weigh_more_and_absent_ones_nothing() -> None:
    weights = class_weights([100, 900, 99, 1, 0])
    assert weights[0] == weights[4] == 0
    assert weights[3] > weights[2] > weights[1] > 0
    milder = class_weights([100, 900, 99, 1, 0], floor=0.1)
    assert weights[3] / weights[1] > milder[3] / milder[1] > 1


def scan() -> LabeledScan:
    """Rows and columns of points at the azimuths of eq 18."""
    rows, columns = 4, 32
    azimuth = np.pi * (1 - 2 * (np.arange(columns) + 0.5) / columns)
    distance = np.random.default_rng(0).uniform(2, 9, (rows, columns))
    channels = np.stack(
        [distance, distance * np.cos(azimuth), distance * np.sin(azimuth), 0 * distance, distance]
    )
    classes = np.random.default_rng(1).integers(1, 5, (rows, columns))
    return LabeledScan(channels.astype(np.float32), classes.astype(np.uint8))


def azimuth_columns(one: LabeledScan) -> np.ndarray:
    columns = one.classes.shape[1]
    angle = np.arctan2(one.channels[2], one.channels[1])
    return np.floor(0.5 * (1 - angle / np.pi) * columns).astype(int)


@pytest.mark.parametrize("changed", [turned_scan(scan(), 5), mirrored_scan(scan())])
def test_a_changed_scan_still_has_its_points_in_the_columns_of_their_azimuths(
    changed: LabeledScan,
) -> None:
    assert (azimuth_columns(changed) == np.arange(32)).all()


def test_a_part_of_a_turn_is_cut_from_the_whole() -> None:
    whole, part = turned_scan(scan(), 7), turned_scan(scan(), 7, 12)
    np.testing.assert_array_equal(part.channels, whole.channels[:, :, :12])
    np.testing.assert_array_equal(part.classes, whole.classes[:, :12])


def test_labels_move_with_their_points() -> None:
    one = scan()
    turned = turned_scan(mirrored_scan(one), 3)
    key = {
        float(d): int(c) for d, c in zip(one.channels[0].ravel(), one.classes.ravel(), strict=True)
    }
    for distance, label in zip(turned.channels[0].ravel(), turned.classes.ravel(), strict=True):
        assert key[float(distance)] == label


def test_a_lost_return_has_neither_input_nor_truth() -> None:
    network = SalsaNext(16, width=0.25)
    mean, std = np.ones(5, np.float32), np.full(5, 2, np.float32)
    task = ScanSegmenter(network, [scan()], mean, std, batch_size=16)
    batch = task.batch(np.random.default_rng(0))
    gone = (batch["input"] == 0).all(dim=1)
    assert gone.any()
    assert (batch["classes"][gone] == 0).all()
    assert (batch["classes"][~gone] > 0).all()
