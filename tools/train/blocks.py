"""The building blocks that the image networks share: convolution, normalization, activation."""

from __future__ import annotations

from torch import Tensor, nn


def scaled(channels: int, width: float, base: int = 8) -> int:
    """Channels times width as TensorFlow's zoo rounds: to a multiple of 8, at least 8."""
    return max(int(channels * width / base + 0.5) * base, base)


class ConvBn(nn.Sequential):
    """Convolution (padded to keep size / stride), batch normalization and, by default, relu6.

    Relu6 bounds what an 8-bit tensor must hold, and the Edge TPU runs it inside the convolution.
    """

    def __init__(
        self,
        before: int,
        after: int,
        kernel: int = 3,
        stride: int = 1,
        *,
        groups: int = 1,
        dilation: int = 1,
        activation: type[nn.Module] | None = nn.ReLU6,
    ) -> None:
        padding = dilation * (kernel // 2)
        convolution = nn.Conv2d(
            before, after, kernel, stride, padding, dilation, groups, bias=False
        )
        nn.init.kaiming_normal_(convolution.weight, mode="fan_out", nonlinearity="relu")
        if groups > 1:  # fan_out counts all channels, though each sees its own alone
            convolution.weight.data *= groups**0.5
        layers: list[nn.Module] = [convolution, nn.BatchNorm2d(after)]
        if activation is not None:
            layers.append(activation())
        super().__init__(*layers)


class Residual(nn.Module):
    """`body`(x) + x."""

    def __init__(self, body: nn.Module) -> None:
        super().__init__()
        self.body = body

    def forward(self, x: Tensor) -> Tensor:
        y: Tensor = self.body(x)
        return y + x


def parameters_of(module: nn.Module) -> int:
    """How many numbers are trained."""
    return sum(parameter.numel() for parameter in module.parameters())
