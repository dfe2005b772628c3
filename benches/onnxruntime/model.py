"""ViT-S/16 with the DPT decoder of the original tactile transformer, 64 channels, as ONNX; started by run.sh."""

import sys

import torch
import torch.nn.functional as F
from torch import nn

WIDTH, DEPTH, HEADS, CHANNELS, SIDE = 384, 12, 6, 64, 224
GRID = SIDE // 16


class Block(nn.Module):
    def __init__(self):
        super().__init__()
        self.norm1, self.norm2 = nn.LayerNorm(WIDTH, eps=1e-6), nn.LayerNorm(WIDTH, eps=1e-6)
        self.qkv, self.proj = nn.Linear(WIDTH, 3 * WIDTH), nn.Linear(WIDTH, WIDTH)
        self.mlp = nn.Sequential(nn.Linear(WIDTH, 4 * WIDTH), nn.GELU(), nn.Linear(4 * WIDTH, WIDTH))

    def forward(self, x):
        tokens = x.shape[1]
        q, k, v = self.qkv(self.norm1(x)).reshape(1, tokens, 3, HEADS, WIDTH // HEADS).permute(2, 0, 3, 1, 4)
        weights = (q @ k.transpose(-2, -1) * (WIDTH // HEADS) ** -0.5).softmax(dim=-1)
        x = x + self.proj((weights @ v).transpose(1, 2).reshape(1, tokens, WIDTH))
        return x + self.mlp(self.norm2(x))


class Unit(nn.Module):
    def __init__(self):
        super().__init__()
        self.conv1, self.conv2 = (nn.Conv2d(CHANNELS, CHANNELS, 3, padding=1) for _ in range(2))

    def forward(self, x):
        return x + self.conv2(F.relu(self.conv1(F.relu(x))))


class Network(nn.Module):
    def __init__(self):
        super().__init__()
        self.patch = nn.Conv2d(3, WIDTH, 16, stride=16)
        self.cls = nn.Parameter(torch.randn(1, 1, WIDTH) * 0.02)
        self.positions = nn.Parameter(torch.randn(1, GRID * GRID + 1, WIDTH) * 0.02)
        self.blocks = nn.ModuleList(Block() for _ in range(DEPTH))
        self.read = nn.ModuleList(nn.Sequential(nn.Linear(2 * WIDTH, WIDTH), nn.GELU()) for _ in range(4))
        self.project = nn.ModuleList(nn.Conv2d(WIDTH, CHANNELS, 1) for _ in range(4))
        self.resize = nn.ModuleList(
            [nn.ConvTranspose2d(CHANNELS, CHANNELS, 4, stride=4), nn.ConvTranspose2d(CHANNELS, CHANNELS, 2, stride=2)]
            + [nn.Identity(), nn.Conv2d(CHANNELS, CHANNELS, 2, stride=2)]
        )
        self.units = nn.ModuleList(nn.ModuleList([Unit(), Unit()]) for _ in range(4))
        head = lambda: nn.ModuleList(
            [nn.Conv2d(CHANNELS, CHANNELS // 2, 3, padding=1), nn.Conv2d(CHANNELS // 2, 32, 3, padding=1), nn.Conv2d(32, 1, 1)]
        )
        self.heads = nn.ModuleList([head(), head()])

    def forward(self, image):
        larger = lambda x: F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=True)
        x = torch.cat([self.cls, self.patch(image).flatten(2).transpose(1, 2)], dim=1) + self.positions
        maps = []
        for k, block in enumerate(self.blocks):
            x = block(x)
            if k % 3 == 2:
                level = k // 3
                tokens = torch.cat([x[:, 1:], x[:, :1].expand(1, GRID * GRID, WIDTH)], dim=-1)
                m = self.read[level](tokens).transpose(1, 2).reshape(1, WIDTH, GRID, GRID)
                maps.append(self.resize[level](self.project[level](m)))
        fused = None
        for level in 3, 2, 1, 0:
            unit1, unit2 = self.units[level]
            f = unit1(maps[level])
            fused = larger(unit2(f if fused is None else f + fused))
        heads = [conv3(F.relu(conv2(larger(conv1(fused))))) for conv1, conv2, conv3 in self.heads]
        return torch.cat(heads, dim=1)


torch.manual_seed(0)
network = Network().eval()
print(f"{sum(p.numel() for p in network.parameters()) / 1e6:.2f} M parameters")
torch.onnx.export(
    network, torch.rand(1, 3, SIDE, SIDE), sys.argv[1], input_names=["image"], opset_version=17, dynamo=False
)
