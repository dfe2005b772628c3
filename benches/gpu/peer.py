"""Times PyTorch with the networks `vit`, `mamba` and `robust_mamba` on one NVIDIA GPU, to compare with our engine.

    python peer.py --network vit --mode train --size 224 --batch 64 --precision bf16
    python peer.py --list measurements.json
    python peer.py --check
    python peer.py --weights ours.safetensors --images images.npy --out predictions.npy

A measurement prints one line of JSON. A list is a JSON array of objects whose keys are the names of the options (network, depth, hooks,
mode, size, batch, precision, channels_last, seconds, weights); missing ones have the values of the command line. A measurement that
fails gives a line with "error", and the list goes on.

PyTorch runs eagerly, with its own attention, convolutions and AdamW, and cuDNN picks its algorithms by trial. Only the selective scan of
Mamba is a kernel of this file, in Triton, with its backward pass, since PyTorch has none. A step of training is: zero the gradients,
forward pass, loss, backward pass, clipping, AdamW; it has no moving average of the weights and no schedule of the step size. Images and
targets are random and lie on the GPU. perception/touch/src/network.rs defines the networks. Only --images needs NumPy.
"""

import argparse
import functools
import gc
import itertools
import json
import math
import statistics
import sys
import time
from collections import OrderedDict
from pathlib import Path

import torch
import torch.nn.functional as F
import triton
import triton.language as tl
from torch import nn

SHARED = {"patch": 16, "width": 384, "depth": 12, "hooks": [2, 5, 8, 11], "channels": 128}
SCAN = {"state": 16, "expand": 2, "taps": 4, "scans": ["rows"]}
PRESETS = {
    "vit": {**SHARED, "heads": 6, "mlp": 4, "positions": [20, 15]},
    "mamba": {**SHARED, **SCAN, "positions": [20, 15]},
    "robust_mamba": {**SHARED, **SCAN, "mlp": 4},
}
# Channels of a program of the scan: one per thread of a warp.
SCAN_CHANNELS = 32
# Tokens between two states that the forward pass of the scan keeps; the backward pass computes the others again.
SCAN_CHUNK = 16
WARM_UP_STEPS = 8
CHOICES = {"network": list(PRESETS), "mode": ["train", "infer"], "precision": ["tf32", "bf16", "fp32"]}


@triton.jit
def scan_parameters(a_log, skip, bias, inner, states, STATES: tl.constexpr, CHANNELS: tl.constexpr):
    """Returns the places of a program and its parameters: A, D and the bias of the steps."""
    channel, state = tl.program_id(1) * CHANNELS + tl.arange(0, CHANNELS), tl.arange(0, STATES)
    inside, used = channel < inner, state < states
    both, place = used[:, None] & inside[None, :], channel[None, :] * states + state[:, None]
    a = -tl.exp(tl.load(a_log + place, mask=both, other=0.0))
    d, e = tl.load(skip + channel, mask=inside, other=0.0), tl.load(bias + channel, mask=inside, other=0.0)
    return tl.program_id(0).to(tl.int64), channel, inside, state, used, place, both, a, d, e


@triton.jit
def scan_inputs(sources, row):
    """Returns x of a token, its step before and after softplus, B, C and z."""
    x, delta, b, c, z, e, channel, inside, state, used, inner, bc_row, z_row = sources
    u = tl.load(x + row * inner + channel, mask=inside, other=0.0).to(tl.float32)
    raw = tl.load(delta + row * inner + channel, mask=inside, other=0.0).to(tl.float32) + e
    step = tl.where(raw > 20.0, raw, tl.log(1.0 + tl.exp(tl.minimum(raw, 20.0))))
    bt = tl.load(b + row * bc_row + state, mask=used, other=0.0).to(tl.float32)
    ct = tl.load(c + row * bc_row + state, mask=used, other=0.0).to(tl.float32)
    return u, raw, step, bt, ct, tl.load(z + row * z_row + channel, mask=inside, other=0.0).to(tl.float32)


@triton.jit
def scan_forward(
    x, delta, a_log, b, c, skip, bias, z, kept, y, tokens, inner, states, bc_row, z_row,
    STATES: tl.constexpr, CHANNELS: tl.constexpr, CHUNK: tl.constexpr, KEEP: tl.constexpr,
):  # fmt: skip
    """Scans the tokens of an image for CHANNELS channels, one after the other; keeps the states before each chunk if KEEP."""
    parameters = scan_parameters(a_log, skip, bias, inner, states, STATES, CHANNELS)
    image, channel, inside, state, used, place, both, a, d, e = parameters
    h = tl.zeros([STATES, CHANNELS], tl.float32)
    sources = x, delta, b, c, z, e, channel, inside, state, used, inner, bc_row, z_row
    top = image * tokens
    u, _, step, bt, ct, zt = scan_inputs(sources, top)
    for first in range(0, tokens, CHUNK):
        if KEEP:
            chunk = image * tl.cdiv(tokens, CHUNK) + first // CHUNK
            tl.store(kept + chunk * inner * states + place, h, mask=both)
        for t in range(first, min(first + CHUNK, tokens)):
            # The next token is loaded before this one is used, so that both take their time together.
            u2, _, step2, b2, c2, z2 = scan_inputs(sources, top + min(t + 1, tokens - 1))
            h = tl.exp(step[None, :] * a) * h + (step * u)[None, :] * bt[:, None]
            read = (tl.sum(h * ct[:, None], 0) + d * u) * zt * tl.sigmoid(zt)
            tl.store(y + (top + t) * inner + channel, read.to(y.dtype.element_ty), mask=inside)
            u, step, bt, ct, zt = u2, step2, b2, c2, z2


@triton.jit
def scan_backward(
    x, delta, a_log, b, c, skip, bias, z, kept, scratch, by_y, by_x, by_delta, by_a_log, by_b, by_c, by_skip, by_bias, by_z,
    tokens, inner, states, bc_row, z_row, STATES: tl.constexpr, CHANNELS: tl.constexpr, CHUNK: tl.constexpr,
):  # fmt: skip
    """Computes the gradients of `scan_forward`, chunk by chunk from the end; those that programs share are added up."""
    parameters = scan_parameters(a_log, skip, bias, inner, states, STATES, CHANNELS)
    image, channel, inside, state, used, place, both, a, d, e = parameters
    by_h, sum_a = tl.zeros([STATES, CHANNELS], tl.float32), tl.zeros([STATES, CHANNELS], tl.float32)
    sum_skip, sum_bias = tl.zeros([CHANNELS], tl.float32), tl.zeros([CHANNELS], tl.float32)
    sources = x, delta, b, c, z, e, channel, inside, state, used, inner, bc_row, z_row
    chunks = tl.cdiv(tokens, CHUNK)
    for back in range(chunks):
        chunk = chunks - 1 - back
        top, count = image * tokens + chunk * CHUNK, min(CHUNK, tokens - chunk * CHUNK)
        h = tl.load(kept + (image * chunks + chunk) * inner * states + place, mask=both, other=0.0)
        for k in range(count):
            u, _, step, bt, ct, zt = scan_inputs(sources, top + k)
            tl.store(scratch + (image * CHUNK + k) * inner * states + place, h, mask=both)
            h = tl.exp(step[None, :] * a) * h + (step * u)[None, :] * bt[:, None]
        tl.debug_barrier()
        for j in range(count):
            k, row = count - 1 - j, top + count - 1 - j
            u, raw, step, bt, ct, zt = scan_inputs(sources, row)
            g = tl.load(by_y + row * inner + channel, mask=inside, other=0.0).to(tl.float32)
            past = tl.load(scratch + (image * CHUNK + k) * inner * states + place, mask=both, other=0.0)
            share, gate = tl.exp(step[None, :] * a), tl.sigmoid(zt)
            h = share * past + (step * u)[None, :] * bt[:, None]
            slope = g * (tl.sum(h * ct[:, None], 0) + d * u) * gate * (1.0 + zt * (1.0 - gate))
            tl.store(by_z + row * inner + channel, slope.to(by_z.dtype.element_ty), mask=inside)
            g = g * zt * gate
            sum_skip += g * u
            tl.atomic_add(by_c + row * states + state, tl.sum(g[None, :] * h, 1), mask=used, sem="relaxed")
            by_h += g[None, :] * ct[:, None]
            tl.atomic_add(by_b + row * states + state, tl.sum(by_h * (step * u)[None, :], 1), mask=used, sem="relaxed")
            by_driven = tl.sum(by_h * bt[:, None], 0)
            slope = by_driven * step + g * d
            tl.store(by_x + row * inner + channel, slope.to(by_x.dtype.element_ty), mask=inside)
            by_h *= share
            sum_a += by_h * past * step[None, :]
            slope = (by_driven * u + tl.sum(by_h * past * a, 0)) * tl.sigmoid(raw)
            sum_bias += slope
            tl.store(by_delta + row * inner + channel, slope.to(by_delta.dtype.element_ty), mask=inside)
        tl.debug_barrier()
    # The slope of A = -exp(A_log) is A.
    tl.atomic_add(by_a_log + place, sum_a * a, mask=both, sem="relaxed")
    tl.atomic_add(by_skip + channel, sum_skip, mask=inside, sem="relaxed")
    tl.atomic_add(by_bias + channel, sum_bias, mask=inside, sem="relaxed")


class TritonScan(torch.autograd.Function):
    """Selective scan with its gate; see `scan_loop`."""

    @staticmethod
    def forward(ctx, x, delta, a_log, b, c, skip, bias, z):
        x, delta, keep = x.contiguous(), delta.contiguous(), any(ctx.needs_input_grad)
        (images, tokens, inner), states = x.shape, a_log.shape[1]
        # B and C are slices of one projection, and z is half of another.
        assert b.stride() == c.stride() == (tokens * b.stride(1), b.stride(1), 1)
        assert z.stride() == (tokens * z.stride(1), z.stride(1), 1)
        inputs, y = [x, delta, a_log, b, c, skip, bias, z], torch.empty_like(x)
        kept = torch.empty(images, triton.cdiv(tokens, SCAN_CHUNK), inner, states, device=x.device) if keep else y
        grid, sizes = (images, triton.cdiv(inner, SCAN_CHANNELS)), (tokens, inner, states, b.stride(1), z.stride(1))
        shape = {"STATES": triton.next_power_of_2(states), "CHANNELS": SCAN_CHANNELS, "CHUNK": SCAN_CHUNK, "num_warps": 1}
        scan_forward[grid](*inputs, kept, y, *sizes, **shape, KEEP=keep)
        ctx.save_for_backward(*inputs, kept)
        ctx.launch = grid, sizes, shape
        return y

    @staticmethod
    def backward(ctx, by_y):
        x, delta, a_log, b, c, skip, bias, z, kept = ctx.saved_tensors
        grid, sizes, shape = ctx.launch
        scratch = kept.new_empty(x.shape[0], SCAN_CHUNK, *a_log.shape)
        by_x, by_delta, by_z = torch.empty_like(x), torch.empty_like(delta), torch.empty_like(x, dtype=z.dtype)
        by_b, by_c = (torch.zeros(b.shape, device=b.device) for _ in range(2))
        by_a_log, by_skip, by_bias = (torch.zeros_like(part) for part in (a_log, skip, bias))
        results = by_x, by_delta, by_a_log, by_b, by_c, by_skip, by_bias, by_z
        scan_backward[grid](*ctx.saved_tensors, scratch, by_y.contiguous(), *results, *sizes, **shape)
        return by_x, by_delta, by_a_log, by_b.to(b.dtype), by_c.to(c.dtype), by_skip, by_bias, by_z


def scan_loop(x, delta, a_log, b, c, skip, bias, z):
    """Returns (h C + D x) silu(z) of every token, one token after the other, with A = -exp(A_log), s = softplus(delta + bias) and
    h = exp(s A) h + s x B. Tokens are [images, tokens, channels]; `a_log` is [channels, states]; `b`, `c` [images, tokens, states]."""
    kind = x.dtype
    x, delta, b, c, z = (part.float() for part in (x, delta, b, c, z))
    step, a = F.softplus(delta + bias), -torch.exp(a_log)
    h, ys = x.new_zeros(x.shape[0], *a_log.shape), []
    for t in range(x.shape[1]):
        h = h * torch.exp(step[:, t, :, None] * a) + (step[:, t] * x[:, t])[:, :, None] * b[:, t, None]
        ys.append((h * c[:, t, None]).sum(-1) + skip * x[:, t])
    return (torch.stack(ys, 1) * F.silu(z)).to(kind)


class Mamba(nn.Module):
    def __init__(self, width, state, expand, taps):
        super().__init__()
        inner, rank = expand * width, -(-width // 16)
        self.split = [rank, state, state]
        self.in_proj = nn.Linear(width, 2 * inner, bias=False)
        taps = torch.empty(inner, taps).uniform_(-1, 1) * taps**-0.5
        self.conv1d = nn.ParameterDict({"weight": taps, "bias": torch.zeros(inner)})
        self.x_proj = nn.Linear(inner, rank + 2 * state, bias=False)
        self.dt_proj = nn.Linear(rank, inner)
        self.A_log = nn.Parameter(torch.log(torch.arange(1.0, state + 1)).repeat(inner, 1))
        self.D = nn.Parameter(torch.ones(inner))
        self.out_proj = nn.Linear(inner, width, bias=False)
        # Steps between 1e-3 and 1e-1; the bias is their inverse under softplus.
        step = torch.empty(inner).uniform_(math.log(1e-3), math.log(1e-1)).exp()
        self.dt_proj.bias.data = step + torch.log(-torch.expm1(-step))

    def forward(self, u, order):
        """`order` has the index of the k-th token, and the place of each token in that order; None is the order of the tokens."""
        u = u if order is None else u[:, order[0]]
        x, z = self.in_proj(u).chunk(2, dim=-1)
        (inner, taps), tokens = self.conv1d["weight"].shape, x.shape[1]
        kernels = self.conv1d["weight"][:, None], self.conv1d["bias"]
        x = F.conv1d(x.transpose(1, 2), *kernels, padding=taps - 1, groups=inner)[:, :, :tokens]
        x = F.silu(x.transpose(1, 2).contiguous())
        d, b, c = self.x_proj(x).split(self.split, dim=-1)
        delta = F.linear(d, self.dt_proj.weight)
        scan = TritonScan.apply if x.is_cuda else scan_loop
        y = self.out_proj(scan(x, delta, self.A_log, b, c, self.D, self.dt_proj.bias, z))
        return y if order is None else y[:, order[1]]


class Attention(nn.Module):
    def __init__(self, width, heads):
        super().__init__()
        self.heads, self.qkv, self.proj = heads, nn.Linear(width, 3 * width), nn.Linear(width, width)

    def forward(self, x):
        qkv = self.qkv(x).unflatten(2, (3, self.heads, -1)).permute(2, 0, 3, 1, 4)
        return self.proj(F.scaled_dot_product_attention(*qkv.unbind(0)).transpose(1, 2).flatten(2))


class Block(nn.Module):
    """Block of any of the three networks."""

    def __init__(self, a):
        super().__init__()
        self.name, width = a["name"], a["width"]
        if self.name == "vit":
            self.attn = Attention(width, a["heads"])
        else:
            self.mamba = Mamba(width, a["state"], a["expand"], a["taps"])
        if self.name == "mamba":
            self.norm = nn.LayerNorm(width, eps=1e-5)
        else:
            self.norm1, self.norm2 = nn.LayerNorm(width, eps=1e-5), nn.LayerNorm(width, eps=1e-5)
            fc1, fc2 = nn.Linear(width, a["mlp"] * width), nn.Linear(a["mlp"] * width, width)
            self.mlp = nn.Sequential(OrderedDict(fc1=fc1, gelu=nn.GELU(), fc2=fc2))

    def forward(self, x, order):
        if self.name == "vit":
            x = x + self.attn(self.norm1(x))
            return x + self.mlp(self.norm2(x))
        if self.name == "mamba":
            return x + self.mamba(self.norm(x), order)
        return x + self.mlp(self.norm2(self.mamba(self.norm1(x), order)))


class Unit(nn.Module):
    """Residual unit."""

    def __init__(self, channels):
        super().__init__()
        self.conv1, self.conv2 = (nn.Conv2d(channels, channels, 3, padding=1) for _ in range(2))

    def forward(self, x):
        return x + self.conv2(F.relu(self.conv1(F.relu(x))))


class Head(nn.Module):
    def __init__(self, channels):
        super().__init__()
        self.conv1 = nn.Conv2d(channels, -(-channels // 2), 3, padding=1)
        self.conv2 = nn.Conv2d(-(-channels // 2), 32, 3, padding=1)
        self.out = nn.Linear(32, 1)

    def forward(self, x, size):
        y = F.relu(self.conv2(resampled(self.conv1(x), size)))
        return F.conv2d(y, self.out.weight[:, :, None, None], self.out.bias)


class Reassemble(nn.Module):
    """Makes a map of level `k` from tokens."""

    def __init__(self, k, width, channels):
        super().__init__()
        self.factor = 4 >> k if k < 2 else 1
        self.read, self.project = nn.Linear(2 * width, width), nn.Linear(width, channels)
        if k < 2:
            self.resize = nn.Linear(channels, channels * self.factor**2)
        elif k == 3:
            self.resize = nn.Conv2d(channels, channels, 3, stride=2, padding=1)

    def forward(self, x, grid, layout):
        pairs = torch.cat([x[:, :-1], x[:, -1:].expand(-1, x.shape[1] - 1, -1)], dim=2)
        m = self.project(F.gelu(self.read(pairs)))
        m = self.resize(m) if self.factor > 1 else m
        # Depth to space; its result has channels last.
        (rows, columns), s = grid, self.factor
        m = m.reshape(len(m), rows, columns, s, s, -1).transpose(2, 3).reshape(len(m), rows * s, columns * s, -1)
        m = m.permute(0, 3, 1, 2).contiguous(memory_format=layout)
        return self.resize(m) if hasattr(self, "resize") and s == 1 else m


def resampled(x, size):
    if x.shape[2:] == tuple(size):
        return x
    return F.interpolate(x, size=tuple(size), mode="bilinear", align_corners=True)


@functools.lru_cache
@torch.inference_mode(False)
def waves(rows, columns, width, device):
    """Returns the fixed positions of `robust_mamba`."""
    quarter = width // 4
    frequency = 10000 ** (-torch.arange(quarter) / quarter)
    i = torch.arange(rows).repeat_interleave(columns)[:, None] * frequency
    j = torch.arange(columns).repeat(rows)[:, None] * frequency
    return torch.cat([i.sin(), i.cos(), j.sin(), j.cos()], dim=1).to(device)


@functools.lru_cache
@torch.inference_mode(False)
def scan_order(scan, rows, columns, device):
    """Returns the order of a scan with the class token last, and its inverse; None for `rows`."""
    if scan == "rows":
        return None
    grid = torch.arange(rows * columns).reshape(rows, columns)
    order = (grid if scan.startswith("rows") else grid.T).flatten()
    order = torch.cat([order.flip(0) if scan.endswith("reversed") else order, torch.tensor([rows * columns])])
    return order.to(device), order.argsort().to(device)


class Network(nn.Module):
    """Network of an architecture: a dictionary of our hyper-parameters with its `name`. Parameters have our names and shapes."""

    def __init__(self, architecture, channels_last=False):
        super().__init__()
        self.a = a = {**PRESETS[architecture["name"]], **architecture}
        self.layout = torch.channels_last if channels_last else torch.contiguous_format
        width, channels = a["width"], a["channels"]
        self.patch = nn.Linear(3 * a["patch"] ** 2, width)
        if a["name"] != "robust_mamba":
            self.positions = nn.Parameter(0.02 * torch.randn(math.prod(a["positions"]), width))
        self.register_parameter("class", nn.Parameter(0.02 * torch.randn(1, width)))
        self.blocks = nn.ModuleList(Block(a) for _ in range(a["depth"]))
        levels = range(len(a["hooks"]))
        self.reassemble = nn.ModuleList(Reassemble(k, width, channels) for k in levels)
        self.fusion = nn.ModuleList(nn.ModuleDict({f"unit{i}": Unit(channels) for i in (1, 2)}) for _ in levels)
        self.depth, self.contact = Head(channels), Head(channels)
        self.to(memory_format=self.layout)

    def positions_on(self, rows, columns, device):
        """Returns the positions of the tokens [tokens, width]."""
        if self.a["name"] == "robust_mamba":
            return waves(rows, columns, self.a["width"], device)
        table = self.positions.T.reshape(1, -1, *self.a["positions"])
        table = F.interpolate(table, size=(rows, columns), mode="bilinear", align_corners=False)
        return table[0].flatten(1).T

    def forward(self, images):
        """Returns indentation in millimetres and the logit of contact [images, 2, rows, columns] of RGB images [images, rows, columns,
        3] of uint8, whose sides are multiples of the patch."""
        a, size, device = self.a, images.shape[1:3], images.device
        p, rows, columns = a["patch"], size[0] // a["patch"], size[1] // a["patch"]
        patches = (images.float() / 127.5 - 1).reshape(-1, rows, p, columns, p, 3).transpose(2, 3)
        x = self.patch(patches.reshape(-1, rows * columns, 3 * p * p)) + self.positions_on(rows, columns, device)
        x = torch.cat([x, self.get_parameter("class").expand(len(x), 1, -1)], dim=1)
        hooked, scans = [], a.get("scans", ["rows"])
        for k, block in enumerate(self.blocks):
            x = block(x, scan_order(scans[k % len(scans)], rows, columns, device))
            if k in a["hooks"]:
                hooked.append(x)
        fused = None
        for k in reversed(range(len(hooked))):
            f = self.fusion[k]["unit1"](self.reassemble[k](hooked[k], (rows, columns), self.layout))
            f = f if fused is None else f + resampled(fused, f.shape[2:])
            fused = self.fusion[k]["unit2"](f)
        fused = resampled(fused, [2 * side for side in fused.shape[2:]])
        return torch.cat([self.depth(fused, size), self.contact(fused, size)], dim=1)


def touch_loss(output, indentation, contact):
    """Returns the mean of the Huber penalty, linear from 0.02 mm on, with weight 3 in contact, plus 0.1 times the cross-entropy."""
    output = output.float()
    penalty = F.smooth_l1_loss(output[:, 0], indentation, beta=0.02, reduction="none")
    entropy = F.binary_cross_entropy_with_logits(output[:, 1], contact, reduction="none")
    return ((1 + 2 * contact) * penalty + 0.1 * entropy).mean()


def adamw(network):
    """Returns AdamW with our settings: matrices and kernels decay, but not A_log."""
    named = [(p.dim() > 1 and not name.endswith("A_log"), p) for name, p in network.named_parameters()]
    groups = [{"params": [p for decays, p in named if decays == kind], "weight_decay": 0.01 * kind} for kind in (True, False)]
    return torch.optim.AdamW(groups, lr=1e-3, betas=(0.9, 0.99), eps=1e-8)


def read_safetensors(path):
    """Returns tensors and our metadata (a dictionary, perhaps empty). The package safetensors may be missing where this runs."""
    data = bytearray(Path(path).read_bytes())
    end = 8 + int.from_bytes(data[:8], "little")
    header, kinds = json.loads(bytes(data[8:end])), {"F32": torch.float32, "F16": torch.float16, "BF16": torch.bfloat16}
    metadata = json.loads(header.pop("__metadata__", {}).get("mambavitact", "{}"))
    for name, entry in header.items():
        first, last = (end + offset for offset in entry["data_offsets"])
        values = torch.frombuffer(data[first:last], dtype=kinds[entry["dtype"]])
        header[name] = values.float().reshape(entry["shape"])
    return header, metadata


def build(options, device):
    """Returns the network of the options, with the weights of their file if they name one."""
    for key, choices in CHOICES.items():
        if getattr(options, key) not in choices and not (key == "network" and options.weights):
            raise ValueError(f"{key} is {getattr(options, key)!r}; choose one of {', '.join(choices)}")
    tensors, metadata = read_safetensors(options.weights) if options.weights else (None, {})
    architecture = {"name": options.network, **metadata.get("architecture", {})}
    if (name := architecture["name"]) not in PRESETS or options.network not in (None, name):
        raise ValueError(f"{options.weights} has the network {name}; choose a file of {options.network or ', '.join(PRESETS)}")
    architecture |= {key: value for key in ("depth", "hooks") if (value := getattr(options, key)) is not None}
    torch.manual_seed(0)
    network = Network(architecture, options.channels_last)
    if len(network.reassemble) > 4 or network.a["hooks"][-1] + 1 != network.a["depth"]:
        raise ValueError(f"hooks {network.a['hooks']} must be one to four of the {network.a['depth']} blocks from 0, with the last")
    if tensors is not None:
        network.load_state_dict(tensors)
    return network.to(device)


def set_precision(precision, device):
    """Sets the precision and returns the context in which networks run."""
    torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = precision == "tf32"
    torch.backends.cudnn.benchmark = True
    return torch.autocast(device, torch.bfloat16, enabled=precision == "bf16")


def measure(options):
    """Returns the line of a measurement."""
    if not torch.cuda.is_available():
        raise RuntimeError("a measurement needs a CUDA GPU")
    context = set_precision(options.precision, "cuda")
    network = build(options, "cuda")
    shape = (options.batch, options.size, options.size)
    images = torch.randint(0, 256, (*shape, 3), dtype=torch.uint8, device="cuda")
    indentation = F.relu(0.3 * torch.randn(shape, device="cuda"))
    contact, parameters = (indentation > 0).float(), list(network.parameters())
    optimiser = adamw(network) if options.mode == "train" else None

    def train():
        optimiser.zero_grad(set_to_none=True)
        with context:
            output = network(images)
        touch_loss(output, indentation, contact).backward()
        nn.utils.clip_grad_norm_(parameters, 1.0)
        optimiser.step()

    @torch.inference_mode()
    def infer():
        with context:
            return network(images)

    step = train if options.mode == "train" else infer
    for _ in range(WARM_UP_STEPS):
        step()
    torch.cuda.synchronize()
    torch.cuda.reset_peak_memory_stats()
    events = [torch.cuda.Event(enable_timing=True)]
    events[0].record()
    end = time.perf_counter() + options.seconds
    while len(events) <= 10 or time.perf_counter() < end:
        step()
        events.append(torch.cuda.Event(enable_timing=True))
        events[-1].record()
        # The CPU runs two steps ahead at most, so that the time that passes on the GPU is the time measured here.
        events[max(len(events) - 3, 0)].synchronize()
    events[-1].synchronize()
    ms = statistics.median(first.elapsed_time(last) for first, last in itertools.pairwise(events))
    return {
        "network": network.a["name"], "depth": network.a["depth"], "mode": options.mode, "size": options.size,
        "batch": options.batch, "precision": options.precision, "channels_last": options.channels_last,
        "images_per_s": round(1000 * options.batch / ms, 2), "ms": round(ms, 4), "steps": len(events) - 1,
        "peak_memory_mb": round(torch.cuda.max_memory_allocated() / 1e6, 1),
        "parameters": sum(parameter.numel() for parameter in parameters),
        "device": torch.cuda.get_device_name(), "torch": torch.__version__,
    }  # fmt: skip


def predict(options):
    """Writes the predictions for the images of a file, float32 [images, rows, columns, 2]."""
    import numpy

    device = "cuda" if torch.cuda.is_available() else "cpu"
    context = set_precision(options.precision, device)
    network, outputs = build(options, device), []
    with torch.inference_mode(), context:
        for batch in torch.from_numpy(numpy.load(options.images)).split(options.batch):
            outputs.append(network(batch.to(device)).float().permute(0, 2, 3, 1).cpu())
    numpy.save(options.out, torch.cat(outputs).contiguous().numpy())
    return {"network": network.a["name"], "precision": options.precision, "images": sum(map(len, outputs)), "out": options.out}


def check_scan(device, images, tokens, inner, states, kind):
    """Returns results and gradients of the Triton scan and of the loop."""
    torch.manual_seed(tokens)
    rank, sides = 3, (images, tokens)
    widths = rank + 2 * states, 2 * inner, inner, inner
    projected, xz, delta, gradient = (torch.randn(*sides, width, device=device).to(kind) for width in widths)
    parameters = [torch.randn(*shape, device=device) for shape in ((inner, states), (inner,), (inner,))]
    results = []
    for scan in TritonScan.apply, scan_loop:
        leaves = [part.clone().requires_grad_() for part in (projected, xz, delta, *parameters)]
        _, b, c = leaves[0].split([rank, states, states], dim=-1)
        x, z = leaves[1].chunk(2, dim=-1)
        inputs = x, leaves[2], leaves[3], b, c, leaves[4], leaves[5], z
        y = scan(*inputs)
        with torch.inference_mode():
            again = scan(*inputs)
        results.append([y, again, *torch.autograd.grad(y, leaves, gradient)])
    return results


def check_network(name):
    """Returns the output and the gradient of a small network on the GPU and on the CPU."""
    torch.manual_seed(1)
    small = {"name": name, "patch": 8, "width": 48, "depth": 4, "hooks": [0, 1, 2, 3], "channels": 12}
    small |= {"vit": {"heads": 3}}.get(name, {"scans": ["rows", "columns_reversed"], "state": 5})
    network, results = Network(small), []
    images, indentation = torch.randint(0, 256, (3, 40, 56, 3), dtype=torch.uint8), F.relu(torch.randn(3, 40, 56))
    for device in "cuda", "cpu":
        network = network.to(device)
        output, targets = network(images.to(device)), indentation.to(device)
        slopes = torch.autograd.grad(touch_loss(output, targets, (targets > 0).float()), list(network.parameters()))
        results.append([output.cpu(), torch.cat([slope.flatten().cpu() for slope in slopes])])
    return results


def check():
    """Compares the Triton scan with the loop, and networks on the GPU with the CPU. Returns whether all are alike."""
    device, interpreted = ("cuda" if torch.cuda.is_available() else "cpu"), triton.knobs.runtime.interpret
    if device == "cpu" and not interpreted:
        sys.exit("the check needs a CUDA GPU, or TRITON_INTERPRET=1 in the environment")
    set_precision("fp32", device)
    sizes = [(2, 5, 20, 4), (1, 37, 40, 9), (2, 33, 32, 16)] + ([] if interpreted else [(3, 197, 768, 16), (1, 577, 768, 16)])
    kinds = (torch.float32, 1e-4), (torch.bfloat16, 1e-2)
    cases = [(f"scan {size} {kind}", check_scan, (device, *size, kind), limit) for size in sizes for kind, limit in kinds]
    cases += [(name, check_network, (name,), 1e-3) for name in PRESETS if device == "cuda"]
    alike = True
    for title, function, arguments, limit in cases:
        # Lengths of the differences, in lengths of the correct results.
        distances = [((a.float() - b.float()).norm() / b.float().norm()).item() for a, b in zip(*function(*arguments))]
        alike &= (good := all(value <= limit for value in distances))
        print(f"{title}: {', '.join(f'{value:.1e}' for value in distances)}, limit {limit}: {'ok' if good else 'FAILED'}", flush=True)
    return alike


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add, split_hooks = parser.add_argument, lambda text: [int(hook) for hook in text.split(",")]
    add("--network", choices=CHOICES["network"], help="network; with --weights that of the file")
    add("--depth", type=int, help="blocks (default: 12)")
    add("--hooks", type=split_hooks, help="blocks that the decoder sees, such as 5,11,17,23 (default: 2,5,8,11)")
    add("--mode", choices=CHOICES["mode"], default="infer", help="what is measured (default: %(default)s)")
    add("--size", type=int, default=224, help="side of the images, pixels (default: %(default)s)")
    add("--batch", type=int, default=32, help="images per step (default: %(default)s)")
    add("--precision", choices=CHOICES["precision"], default="tf32", help="TF32, autocast to bfloat16, or neither (default: tf32)")
    add("--channels-last", action="store_true", help="store maps of the decoder with channels last")
    add("--seconds", type=float, default=4.0, help="length of a measurement, seconds (default: %(default)s)")
    add("--weights", help="file of our weights (safetensors); its architecture is used")
    add("--images", help="predict these images instead: a .npy file of uint8 [images, rows, columns, 3]")
    add("--out", help="file for the predictions, .npy of float32 [images, rows, columns, 2]")
    add("--list", help="JSON file with a list of measurements")
    add("--check", action="store_true", help="compare the Triton scan with a loop, and the GPU with the CPU")
    options, failed = parser.parse_args(), False
    if options.check:
        sys.exit(0 if check() else 1)
    if (options.images is None) != (options.out is None):
        parser.error("--images and --out need each other")
    if options.images:
        print(json.dumps(predict(options)))
        return
    for entry in json.loads(Path(options.list).read_text()) if options.list else [{}]:
        try:
            entry = {key.replace("-", "_"): value for key, value in entry.items()}
            if unknown := entry.keys() - vars(options).keys():
                raise ValueError(f"unknown keys {sorted(unknown)}")
            entry |= {"hooks": split_hooks(entry["hooks"])} if isinstance(entry.get("hooks"), str) else {}
            line = measure(argparse.Namespace(**{**vars(options), **entry}))
        except Exception as error:  # Whatever fails, the other measurements go on.
            line, failed = {**entry, "error": f"{type(error).__name__}: {error}"}, True
        print(json.dumps(line), flush=True)
        gc.collect()
        torch.cuda.empty_cache()
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
