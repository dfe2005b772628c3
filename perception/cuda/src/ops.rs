//! Operations of the networks on the GPU.

use std::rc::Rc;
use std::sync::Arc;

use mvt_training::backend::{Ops, Resample, TrainingImages, WindowAttention};
use mvt_training::mvt_touch::network::{LAYER_NORM_EPS, WeightTensor};

use crate::gpu::{Gpu, Multiply, View, each, launch, warps};
use crate::machine::{Argument, GpuError, Window};
use crate::memory::{DeviceArray, Real};
use crate::tape::{Computed, Node, Var, back};

/// Operations on a GPU.
#[derive(Debug, Clone)]
pub struct GpuOps {
    gpu: Rc<Gpu>,
    /// Images that are on the GPU already, and their rows and columns; networks see them at the size that they ask for.
    images: Option<(DeviceArray<u8>, [usize; 2])>,
}

impl GpuOps {
    /// Returns the operations of a GPU.
    pub fn new(gpu: Rc<Gpu>) -> Self {
        Self { gpu, images: None }
    }

    /// Returns the operations of a GPU for networks that see images which are on it already, of some rows and columns.
    pub fn of_images(gpu: Rc<Gpu>, levels: DeviceArray<u8>, size: [usize; 2]) -> Self {
        Self { gpu, images: Some((levels, size)) }
    }

    /// Returns the levels of images from -1 to 1.
    fn levels(&self, TrainingImages { levels, shape }: TrainingImages<'_>) -> Result<DeviceArray<Real>, GpuError> {
        let gpu = &self.gpu;
        let (uploaded, size) = match &self.images {
            Some((uploaded, size)) => (uploaded.clone(), *size),
            None => {
                let uploaded: DeviceArray<u8> = gpu.array(levels.len())?;
                uploaded.upload(levels)?;
                (uploaded, [shape[1], shape[2]])
            }
        };
        let y = gpu.array(uploaded.len())?;
        launch!(gpu, "from_levels", each(y.len()), &y, &uploaded, y.len())?;
        gpu.resized(&y, [shape[0], size[0], size[1], 3], [shape[1], shape[2]])
    }

    fn made(&self, shape: &[usize], make: impl FnOnce(&Gpu) -> Result<DeviceArray<Real>, GpuError>) -> Var {
        Var::compute(&self.gpu, shape, [], |gpu, [], _| Ok((make(gpu)?, back(|_, _| Ok(())))))
    }

    /// Computes a value from one number per number of the input, and the gradient from numbers of the input and of the gradient.
    fn pointwise(&self, x: &Var, forward: &'static str, backward: &'static str) -> Var {
        Var::compute(&self.gpu, x.shape(), [x], |gpu, [x], _| {
            let (values, len) = (x.values(), x.values().len());
            let y: DeviceArray<Real> = gpu.array(len)?;
            gpu.launch(forward, each(len), &[(&y).into(), values.into(), len.into()])?;
            let gpu = gpu.clone();
            let back = back(move |g, slopes| {
                let by_x = if g.is_unshared() { g.clone() } else { gpu.array(len)? };
                gpu.launch(backward, each(len), &[(&by_x).into(), x.values().into(), (&g).into(), len.into()])?;
                drop(g);
                slopes.give(&x, by_x)
            });
            Ok((y, back))
        })
    }

    /// Moves numbers; the backward kernel takes the same arguments.
    fn moved(&self, x: &Var, shape: &[usize], kernels: [&'static str; 2], arguments: Vec<Argument>) -> Var {
        Var::compute(&self.gpu, shape, [x], |gpu, [x], _| {
            let len = shape.iter().product::<usize>();
            let y: DeviceArray<Real> = gpu.array(len)?;
            let mut all = vec![(&y).into(), x.values().into(), len.into()];
            all.extend(&arguments);
            gpu.launch(kernels[0], each(len), &all)?;
            let gpu = gpu.clone();
            let back = back(move |g, slopes| {
                let len = x.values().len();
                let by_x: DeviceArray<Real> = gpu.array(len)?;
                let mut all = vec![(&by_x).into(), (&g).into(), len.into()];
                all.extend(&arguments);
                gpu.launch(kernels[1], each(len), &all)?;
                slopes.give(&x, by_x)
            });
            Ok((y, back))
        })
    }

    fn matrices(&self, x: &Var, weight: &Var, bias: Option<&Var>) -> Var {
        let (outputs, inputs) = (weight.shape()[0], weight.shape()[1]);
        let mut shape = x.shape().to_vec();
        shape.pop();
        let rows: usize = shape.iter().product();
        shape.push(outputs);
        let compute = |gpu: &Rc<Gpu>, x: Rc<Node>, weight: Rc<Node>, bias: Option<Rc<Node>>| -> Computed {
            let y: DeviceArray<Real> = gpu.array(rows * outputs)?;
            let w = View::rows(weight.values(), inputs).transposed();
            let multiply = Multiply::new([rows, outputs], inputs);
            gpu.multiply(View::rows(x.values(), inputs), w, View::rows(&y, outputs), multiply)?;
            if let Some(bias) = &bias {
                gpu.add_bias(&y, &bias.parameter()?.values)?;
            }
            let gpu = gpu.clone();
            let back = back(move |g, slopes| {
                let g_rows = View::rows(&g, outputs);
                if let Some(sum) = &weight.parameter()?.gradient {
                    let multiply = Multiply::slope([outputs, inputs], rows);
                    gpu.multiply(
                        g_rows.transposed(),
                        View::rows(x.values(), inputs),
                        View::rows(sum, inputs),
                        multiply,
                    )?;
                }
                if let Some(sum) =
                    bias.as_ref().map(|bias| bias.parameter()).transpose()?.and_then(|b| b.gradient.as_ref())
                {
                    gpu.add_columns(sum, &g)?;
                }
                if !x.is_tracked() {
                    return Ok(());
                }
                let by_x: DeviceArray<Real> = gpu.array(rows * inputs)?;
                let w = View::rows(weight.values(), inputs);
                gpu.multiply(g_rows, w, View::rows(&by_x, inputs), Multiply::new([rows, inputs], outputs))?;
                drop(g);
                slopes.give(&x, by_x)
            });
            Ok((y, back))
        };
        match bias {
            None => Var::compute(&self.gpu, &shape, [x, weight], |gpu, [x, weight], _| compute(gpu, x, weight, None)),
            Some(bias) => Var::compute(&self.gpu, &shape, [x, weight, bias], |gpu, [x, weight, bias], _| {
                compute(gpu, x, weight, Some(bias))
            }),
        }
    }
}

impl Ops for GpuOps {
    type Value = Var;

    fn constant(&self, WeightTensor { shape, values }: WeightTensor) -> Var {
        self.made(&shape, |gpu| gpu.uploaded(&values))
    }

    fn fixed(&self, name: &str, shape: &[usize], make: impl FnOnce() -> Vec<f32>) -> Var {
        self.made(shape, |gpu| gpu.fixed(name, shape, make))
    }

    fn patches(&self, images: TrainingImages<'_>, side: usize) -> Var {
        let [count, rows, columns] = images.shape;
        self.made(&[count, rows / side, columns / side, side * side * 3], |gpu| {
            let x = self.levels(images)?;
            let y = gpu.array(x.len())?;
            launch!(gpu, "space_to_depth", each(y.len()), &y, &x, y.len(), rows, columns, 3_usize, side)?;
            Ok(y)
        })
    }

    fn with_coordinates(&self, images: TrainingImages<'_>) -> Var {
        let [count, rows, columns] = images.shape;
        self.made(&[count, rows, columns, 5], |gpu| {
            let x = self.levels(images)?;
            let y = gpu.array(x.len() / 3 * 5)?;
            launch!(gpu, "with_coordinates", each(y.len()), &y, &x, y.len(), rows, columns)?;
            Ok(y)
        })
    }

    fn shape(&self, x: &Var) -> Vec<usize> {
        x.shape().to_vec()
    }

    fn add(&self, a: Var, b: Var) -> Var {
        Var::compute(&self.gpu, a.shape(), [&a, &b], |gpu, [a, b], _| {
            let y = gpu.add(a.values(), b.values(), None)?;
            let back = back(move |g, slopes| {
                slopes.give(&a, g.clone())?;
                slopes.give(&b, g)
            });
            Ok((y, back))
        })
    }

    fn reshape(&self, x: Var, shape: &[usize]) -> Var {
        Var::compute(&self.gpu, shape, [&x], |_, [x], _| {
            let y = x.values().clone();
            Ok((y, back(move |g, slopes| slopes.give(&x, g))))
        })
    }

    fn product(&self, x: Var, weight: Var) -> Var {
        self.matrices(&x, &weight, None)
    }

    fn linear(&self, x: Var, [weight, bias]: [Var; 2]) -> Var {
        self.matrices(&x, &weight, Some(&bias))
    }

    fn norm(&self, x: Var, [weight, bias]: [Var; 2]) -> Var {
        let width = weight.shape()[0];
        Var::compute(&self.gpu, x.shape(), [&x, &weight, &bias], |gpu, [x, weight, bias], _| {
            let (len, rows) = (x.values().len(), x.values().len() / width);
            let (y, moments): (DeviceArray<Real>, DeviceArray<f32>) = (gpu.array(len)?, gpu.array(2 * rows)?);
            let (w, b) = (weight.parameter()?.values.clone(), &bias.parameter()?.values);
            launch!(gpu, "layer_norm", warps(rows), &y, &moments, x.values(), &w, b, rows, width, LAYER_NORM_EPS)?;
            let gpu = gpu.clone();
            let back = back(move |g, slopes| {
                let x_values = x.values();
                if let (Some(by_weight), Some(by_bias)) = (&weight.parameter()?.gradient, &bias.parameter()?.gradient) {
                    let sums = [by_weight, by_bias];
                    gpu.add_row_products("layer_norm_parts", &sums, &[(&moments).into()], [x_values, &g], width)?;
                }
                let by_x: DeviceArray<Real> = gpu.array(len)?;
                launch!(gpu, "layer_norm_back", warps(rows), &by_x, &moments, x_values, &w, &g, rows, width)?;
                drop(g);
                slopes.give(&x, by_x)
            });
            Ok((y, back))
        })
    }

    fn convolution(&self, x: Var, [weight, bias]: [Var; 2], stride: usize, is_rectified: bool) -> Var {
        let x = if is_rectified { self.relu(x) } else { x };
        let window = Window { input: x.sides(), outputs: weight.shape()[0], stride };
        Var::compute(&self.gpu, &window.output(), [&x, &weight, &bias], |gpu, [x, weight, bias], _| {
            let y = gpu.convolve(window, x.values(), weight.values())?;
            gpu.add_bias(&y, &bias.parameter()?.values)?;
            let gpu = gpu.clone();
            let back = back(move |g, slopes| {
                if let (Some(by_weight), Some(by_bias)) = (&weight.parameter()?.gradient, &bias.parameter()?.gradient) {
                    gpu.add_convolve_slopes(window, [x.values(), &g], by_weight)?;
                    gpu.add_columns(by_bias, &g)?;
                }
                if !x.is_tracked() {
                    return Ok(());
                }
                let by_x = gpu.convolve_back(window, &g, weight.values())?;
                drop(g);
                slopes.give(&x, by_x)
            });
            Ok((y, back))
        })
    }

    fn depthwise(&self, x: Var, [weight, bias]: [Var; 2]) -> Var {
        let ([images, rows, columns, channels], side) = (x.sides(), weight.shape()[1]);
        Var::compute(&self.gpu, x.shape(), [&x, &weight, &bias], |gpu, [x, weight, bias], _| {
            let len = x.values().len();
            let y: DeviceArray<Real> = gpu.array(len)?;
            let (w, b) = (weight.parameter()?.values.clone(), &bias.parameter()?.values);
            launch!(gpu, "depthwise", each(len), &y, x.values(), &w, b, len, rows, columns, channels, side, false)?;
            let gpu = gpu.clone();
            let back = back(move |g, slopes| {
                if let (Some(by_weight), Some(by_bias)) = (&weight.parameter()?.gradient, &bias.parameter()?.gradient) {
                    gpu.add_depthwise_slopes([images, rows, columns, channels], side, [x.values(), &g], by_weight)?;
                    gpu.add_columns(by_bias, &g)?;
                }
                let by_x: DeviceArray<Real> = gpu.array(len)?;
                let none = None::<&DeviceArray<f32>>;
                launch!(gpu, "depthwise", each(len), &by_x, &g, &w, none, len, rows, columns, channels, side, true)?;
                slopes.give(&x, by_x)
            });
            Ok((y, back))
        })
    }

    fn scale(&self, x: Var, factors: Var) -> Var {
        let width = factors.shape()[0];
        Var::compute(&self.gpu, x.shape(), [&x, &factors], |gpu, [x, factors], _| {
            let len = x.values().len();
            let y: DeviceArray<Real> = gpu.array(len)?;
            let by = factors.parameter()?.values.clone();
            launch!(gpu, "scale", each(len), &y, x.values(), &by, len, width)?;
            let gpu = gpu.clone();
            let back = back(move |g, slopes| {
                if let Some(sum) = &factors.parameter()?.gradient {
                    gpu.add_row_products("scale_parts", &[sum], &[], [x.values(), &g], width)?;
                }
                let by_x: DeviceArray<Real> = gpu.array(len)?;
                launch!(gpu, "scale", each(len), &by_x, &g, &by, len, width)?;
                slopes.give(&x, by_x)
            });
            Ok((y, back))
        })
    }

    fn selective(&self, order: &Arc<[usize]>, inputs: [Var; 8]) -> Var {
        crate::selective::selective(&self.gpu, order, &inputs)
    }

    fn attention(&self, qkv: Var, heads: usize) -> Var {
        crate::attention::attention(&self.gpu, &qkv, heads)
    }

    fn window_attention(&self, qkv: Var, table: Var, attention: &WindowAttention) -> Var {
        crate::attention::window_attention(&self.gpu, &qkv, &table, attention)
    }

    fn gather(&self, x: Var, tokens: &Arc<[Option<usize>]>) -> Var {
        let ([images, from, width], to) = (x.sides(), tokens.len());
        let list = |places: &[Option<usize>]| -> Vec<i32> {
            places.iter().map(|place| place.map_or(-1, |place| place as i32)).collect()
        };
        let mut places = vec![None; from];
        let mut is_unique = true;
        for (place, token) in tokens.iter().enumerate() {
            if let Some(token) = *token {
                is_unique &= places[token].replace(place).is_none();
            }
        }
        let (forward, backward) = (list(tokens), list(&places));
        Var::compute(&self.gpu, &[images, to, width], [&x], |gpu, [x], is_tracked| {
            if is_tracked && !is_unique {
                return Err(GpuError::Unsuitable("a token is taken twice".to_owned()));
            }
            let y: DeviceArray<Real> = gpu.array(images * to * width)?;
            let indices = gpu.indices(forward.into_iter())?;
            launch!(gpu, "gather", each(y.len()), &y, x.values(), &indices, y.len(), to, from, width)?;
            let gpu = gpu.clone();
            let back = back(move |g, slopes| {
                let by_x: DeviceArray<Real> = gpu.array(images * from * width)?;
                let indices = gpu.indices(backward.into_iter())?;
                launch!(gpu, "gather", each(by_x.len()), &by_x, &g, &indices, by_x.len(), from, to, width)?;
                slopes.give(&x, by_x)
            });
            Ok((y, back))
        })
    }

    fn relu(&self, x: Var) -> Var {
        self.pointwise(&x, "relu", "relu_back")
    }

    fn gelu(&self, x: Var) -> Var {
        self.pointwise(&x, "gelu", "gelu_back")
    }

    fn resample(&self, x: Var, Resample { size, aligned }: Resample) -> Var {
        let [images, rows, columns, channels] = x.sides();
        let sizes = [rows, columns, size[0], size[1], channels].map(Argument::from);
        let arguments = sizes.into_iter().chain([aligned.into()]).collect();
        self.moved(&x, &[images, size[0], size[1], channels], ["resample", "resample_back"], arguments)
    }

    fn depth_to_space(&self, x: Var, factor: usize) -> Var {
        let [images, rows, columns, deep] = x.sides();
        let channels = deep / (factor * factor);
        let arguments = [rows, columns, channels, factor].map(Argument::from).to_vec();
        let shape = [images, rows * factor, columns * factor, channels];
        self.moved(&x, &shape, ["depth_to_space", "depth_to_space_back"], arguments)
    }

    fn add_table(&self, x: Var, table: Var) -> Var {
        Var::compute(&self.gpu, x.shape(), [&x, &table], |gpu, [x, table], _| {
            let (len, period) = (x.values().len(), table.values().len());
            let y: DeviceArray<Real> = gpu.array(len)?;
            launch!(gpu, "add_table", each(len), &y, x.values(), table.values(), len, period)?;
            let gpu = gpu.clone();
            let back = back(move |g, slopes| {
                if table.is_tracked() {
                    slopes.give(&table, gpu.sum_columns(&g, period)?)?;
                }
                slopes.give(&x, g)
            });
            Ok((y, back))
        })
    }

    fn append(&self, x: Var, last: Var) -> Var {
        let [images, tokens, width] = x.sides();
        Var::compute(&self.gpu, &[images, tokens + 1, width], [&x, &last], |gpu, [x, last], _| {
            let y: DeviceArray<Real> = gpu.array(images * (tokens + 1) * width)?;
            launch!(gpu, "append", each(y.len()), &y, x.values(), last.values(), y.len(), tokens + 1, width)?;
            let gpu = gpu.clone();
            let back = back(move |g, slopes| {
                if let Some(sum) = &last.parameter()?.gradient {
                    launch!(gpu, "append_last", each(width), sum, &g, images, tokens + 1, width)?;
                }
                let by_x: DeviceArray<Real> = gpu.array(images * tokens * width)?;
                launch!(gpu, "append_back", each(by_x.len()), &by_x, &g, by_x.len(), tokens + 1, width)?;
                slopes.give(&x, by_x)
            });
            Ok((y, back))
        })
    }

    fn with_last(&self, x: Var) -> Var {
        let [images, tokens, width] = x.sides();
        let arguments = [tokens, width].map(Argument::from).to_vec();
        self.moved(&x, &[images, tokens - 1, 2 * width], ["with_last", "with_last_back"], arguments)
    }

    fn pair(&self, a: Var, b: Var) -> Var {
        let mut shape = a.shape().to_vec();
        shape.pop();
        shape.push(2);
        Var::compute(&self.gpu, &shape, [&a, &b], |gpu, [a, b], _| {
            let len = a.values().len();
            let y: DeviceArray<Real> = gpu.array(2 * len)?;
            launch!(gpu, "pair", each(len), &y, a.values(), b.values(), len)?;
            let gpu = gpu.clone();
            let back = back(move |g, slopes| {
                let (by_a, by_b): (DeviceArray<Real>, DeviceArray<Real>) = (gpu.array(len)?, gpu.array(len)?);
                launch!(gpu, "pair_back", each(len), &by_a, &by_b, &g, len)?;
                slopes.give(&a, by_a)?;
                slopes.give(&b, by_b)
            });
            Ok((y, back))
        })
    }
}
