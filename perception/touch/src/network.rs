//! Descriptions of the networks that turn the image of a DIGIT into indentation and contact: layers, costs and weights.
//!
//! The architectures share their ops, so that training and the engine need few kinds. [`Architecture::layers`] lists a network's
//! layers; tensors, counts and the check of a weights file all come from that list. The following definitions of the layers bind
//! training and engine.
//!
//! # Input and output
//! An RGB image `[height, width, 3]`, both sides multiples of [`Architecture::stride`]; others are first resized to the next
//! multiples ([`Architecture::fit`]), bilinearly with half-pixel centres and clamped edges. Level `v` of 0 to 255 enters as
//! `v / 127.5 - 1`. `default` has two more channels, `x = 2 (u + 0.5) / width - 1` and `y = 2 (v + 0.5) / height - 1` of column `u`
//! and row `v`, since the places of a DIGIT's LEDs are fixed. The output is `[height, width, 2]`: indentation in millimetres, of which
//! users take `max(0, .)`, and the logit of contact.
//!
//! # Layout
//! Maps are `[row, column, channel]`, tokens `[row * columns + column, channel]`: the same memory. All numbers are 32-bit floats.
//!
//! # Ops
//! - **Linear** `name.weight [out, in]`, `name.bias [out]`: `y = W x + b` at every pixel or token.
//! - **Convolution** `name.weight [out, in, 3, 3]` (row, column of the window last), `name.bias [out]`: 3 x 3 correlation, zeros
//!   around the image, stride 1 or 2; with stride 2, output (i, j) is centred on input (2 i, 2 j), and sides are halved upwards.
//! - **Layer norm** `name.weight [width]`, `name.bias [width]`: over channels, biased variance, [`LAYER_NORM_EPS`] added to it.
//! - **Depthwise convolution** `name.weight [width, 7, 7]`, `name.bias [width]`: 7 x 7 correlation of each channel by itself, zeros around
//!   the image.
//! - **Depth to space** by s: channel `(dy * s + dx) * C + c` at (i, j) becomes channel `c` at (s i + dy, s j + dx). **Space to
//!   depth** is its inverse.
//! - **Resampling** of a map to `[h, w]`: bilinear with the corners of both images aligned.
//! - **Residual unit** of a map (`conv1`, `conv2`): `x + conv2(relu(conv1(relu(x))))`.
//! - **Mamba** (`in_proj`, `conv1d`, `x_proj`, `dt_proj`, `A_log`, `D`, `out_proj`, names and shapes of mamba_ssm 1, `conv1d.weight`
//!   without its middle axis of 1), over the tokens `u_t` in the order of a [`ScanOrder`]; with E = expand width, N = state,
//!   R = ceil(width / 16):
//!   `[x, z] = in_proj u` (E each, no bias); `x_t = silu(conv1d.bias + sum over k < K of conv1d.weight[:, k] x_(t - K + 1 + k))`, zeros
//!   before the start; `[d, B, C] = x_proj x` (R, N, N, no bias); `Delta = softplus(dt_proj d)`, with bias;
//!   `h_t = exp(Delta_t A) h_(t-1) + Delta_t x_t B_t` with `A = -exp(A_log) [E, N]` and `h_0 = 0` before the first;
//!   `y_t = h_t C_t + D x_t`; the result `out_proj (y silu(z))`, no bias, returns to the tokens' places.
//!
//! - **Window attention**: attention as in `vit`, within windows of a map ([`ShiftedWindows`]). The table
//!   `relative_position_bias_table [(2 window - 1)^2, heads]` holds a number for each offset of query and key, which is added to their
//!   score ([`relative_position`]). Padding is zero before the linear map `qkv`; it attends and is attended to, as in the original.
//!
//! # `default`
//! A pyramid with Mamba blocks at its coarsest level. With widths c0 to c3:
//! `a0 = relu(stem(image))` at 1/2; `a1 = unit(encoder.0.down(a0))` at 1/4 and `a2 = unit(encoder.1.down(a1))` at 1/8, with the units
//! `encoder.k.unit`; `t = encoder.2.down(a2)` at 1/16; for each block `t = t + mamba(norm(t))`, the scans taking turns; `t = norm(t)`;
//! then `b2 = decoder.0.unit(a2 + up(decoder.0.up(t)))`, `b1 = decoder.1.unit(a1 + up(decoder.1.up(b2)))`,
//! `b0 = decoder.2.unit(a0 + up(decoder.2.up(b1)))`, where `up` is depth to space by 2; the output is depth to space by 2 of
//! `head(relu(b0))`. Downs, stem and head are convolutions, ups are linear. There are no positions but the two channels.
//!
//! # `vit`, `mamba` and `robust_mamba`
//! Tokens are `patch` (linear over space to depth by the side of a patch) plus positions; one more token, `class`, follows. Blocks:
//! - `vit`: `x = x + attn.proj(attention(attn.qkv(norm1(x))))`, `x = x + mlp.fc2(gelu(mlp.fc1(norm2(x))))`; qkv has the rows of
//!   queries, keys, values in that order, each split into heads of width / heads; scores are divided by the root of that; gelu is
//!   the exact one.
//! - `mamba`: `x = x + mamba(norm(x))`.
//! - `robust_mamba`: `x = x + mlp.fc2(gelu(mlp.fc1(norm2(mamba(norm1(x))))))`: one residual around both, as in the original.
//!
//! Positions of `vit` and `mamba` are learned on a grid `positions [rows * columns, width]` and resampled to the image's grid with
//! half-pixel centres and clamped edges; those of `robust_mamba` are `[sin(i w), cos(i w), sin(j w), cos(j w)]` for row i and column j,
//! a quarter of the width each, with `w_k = 10000^(-k / (width / 4))`. The class token has no position of its own.
//!
//! The decoder is that of DPT. The stream after block `hooks[k]` (0-based, shallow first) becomes a map:
//! `m = gelu(reassemble.k.read([token, class]))`, `m = reassemble.k.project(m)`, then for k = 0 `depth_to_space(4, resize(m))`, for k = 1
//! `depth_to_space(2, resize(m))`, both linear, for k = 2 nothing, for k = 3 the convolution `resize` of stride 2. From the coarsest to
//! the finest: `f = fusion.k.unit1(m_k)`, plus the coarser level's result resampled to `m_k`'s size; `f = fusion.k.unit2(f)`. The finest
//! is resampled to twice its size. Each of the heads `depth` and `contact` is `out(relu(conv2(resampled(conv1(f)))))`, where the
//! resampling leads to the input's size and `out` is linear to one channel.
//!
//! # `swin` and `convnext`
//! Four stages at 1/4, 1/8, 1/16 and 1/32, sides rounded up. The first begins with `norm(patch(image))`, a linear map of space to depth by 4.
//! Each other joins squares of 2 x 2 pixels of the stage before it, zeros beyond the map, by space to depth: in `swin`
//! `x = down.linear(down.norm(squares(x)))`, in `convnext` `x = down.linear(squares(down.norm(x)))`. Blocks:
//! - `swin`: those of `vit` with window attention; windows are shifted in every second block of a stage.
//! - `convnext`: `x = x + scale mlp.fc2(gelu(mlp.fc1(norm(depthwise(x)))))`, with a number of `scale` per channel.
//!
//! Each stage gives the decoder a map, `reassemble.k.project(reassemble.k.norm(x))`; the rest is as above.
//!
//! # Differences from published code
//! `vit`, `mamba` and `robust_mamba`: the class token comes last, where a causal scan lets it see the image; hooks tap the stream;
//! the level at 1/32 is a padded convolution, so that odd grids work; the output is indentation without a sigmoid, and contact a
//! single logit. `swin` and `convnext`: merging has a bias in `swin` and pads odd maps in `convnext`, which the original cuts off; the
//! constant added to a variance is the same everywhere.

mod architecture;
mod cost;
mod image_size;
mod layer;
mod weights;
mod windows;

pub use architecture::{Architecture, ConvNext, Mamba, Pyramid, RobustMamba, ScanOrder, Swin, UnknownNetwork, Vit};
pub use cost::Cost;
pub use image_size::ImageSizeError;
pub use layer::{Grid, LAYER_NORM_EPS, NetworkLayer, Op};
pub use weights::{Precision, Provenance, WeightTensor, Weights, WeightsError, write_tensors};
pub use windows::{ShiftedWindows, relative_position, squares};
