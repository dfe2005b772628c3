//! The inside of a Mamba block; see `kernels/scan.cu`.

use std::rc::Rc;
use std::sync::Arc;

use crate::gpu::{Gpu, Multiply, View, each, launch};
use crate::machine::{GpuError, Launch};
use crate::memory::{DeviceArray, Real};
use crate::tape::{Var, back};

/// Tokens between two states that the forward pass leaves for the backward pass; `CHUNK` of the kernels.
const CHUNK: usize = 16;
/// Channels of a block of the scan; `CHANNELS` of the kernels.
const CHANNELS: usize = 32;
/// Threads of a block of the scan; `THREADS` of the kernels.
const THREADS: u32 = 128;
/// Most states of a channel; `LANES * STATES` of the kernels.
const MOST_STATES: usize = 16;
/// Most taps of the convolution; `MOST_TAPS` of the kernels.
const MOST_TAPS: usize = 4;
/// Tokens of a block of the convolution's backward pass.
const CONVOLVED: usize = 32;

/// Everything between the outer projections of a Mamba block; inputs as for `Ops::selective`.
pub fn selective(gpu: &Rc<Gpu>, order: &Arc<[usize]>, inputs: &[Var; 8]) -> Var {
    let [xz, taps, _, projection, step, _, a_log, _] = inputs;
    let [images, tokens, double] = xz.sides();
    let (inner, tap_count, columns) = (double / 2, taps.shape()[1], projection.shape()[0]);
    let (rank, state) = (step.shape()[1], a_log.shape()[1]);
    let rows = images * tokens;
    Var::compute(gpu, &[images, tokens, inner], inputs.each_ref(), |gpu, nodes, is_tracked| {
        if state > MOST_STATES || tap_count > MOST_TAPS {
            return Err(GpuError::Unsuitable(format!(
                "a Mamba block of {state} states and {tap_count} taps; on a GPU it may have {MOST_STATES} and {MOST_TAPS}"
            )));
        }
        let [xz, taps, bias, projection, step, step_bias, a_log, skip] = nodes;
        let order = gpu.indices(order.iter().map(|&token| token as i32))?;
        let u: DeviceArray<Real> = gpu.array(rows * inner)?;
        let (w, b) = (taps.parameter()?.values.clone(), bias.parameter()?.values.clone());
        launch!(gpu, "causal", each(u.len()), &u, xz.values(), &w, &b, &order, u.len(), tokens, inner, tap_count)?;
        let projected: DeviceArray<Real> = gpu.array(rows * columns)?;
        let onto = View::rows(projection.values(), inner).transposed();
        gpu.multiply(
            View::rows(&u, inner),
            onto,
            View::rows(&projected, columns),
            Multiply::new([rows, columns], inner),
        )?;
        // The product that leads to the step sizes is not kept: it costs little and is as large as the result.
        let source_of = move |gpu: &Gpu, step: &DeviceArray<Real>, projected: &DeviceArray<Real>| {
            let source: DeviceArray<Real> = gpu.array(rows * inner)?;
            let onto = View::rows(step, rank).transposed();
            let multiply = Multiply::new([rows, inner], rank);
            gpu.multiply(View::rows(projected, columns), onto, View::rows(&source, inner), multiply)?;
            Ok::<_, GpuError>(source)
        };
        let source = source_of(gpu, step.values(), &projected)?;

        let out: DeviceArray<Real> = gpu.array(rows * inner)?;
        let states = images * tokens.div_ceil(CHUNK) * inner * state;
        let before: Option<DeviceArray<f32>> = is_tracked.then(|| gpu.array(states)).transpose()?;
        let blocks = inner.div_ceil(CHANNELS);
        let grid = Launch { blocks: [blocks as u32, images as u32, 1], threads: THREADS };
        let (sb, a, d) = (
            step_bias.parameter()?.values.clone(),
            a_log.parameter()?.values.clone(),
            skip.parameter()?.values.clone(),
        );
        launch!(
            gpu,
            "scan",
            grid,
            &out,
            before.as_ref(),
            xz.values(),
            &u,
            &source,
            &sb,
            &projected,
            &a,
            &d,
            &order,
            tokens,
            inner,
            state,
            rank
        )?;
        let gpu = gpu.clone();
        let back = back(move |g, slopes| {
            let source = source_of(&gpu, step.values(), &projected)?;
            let by_xz: DeviceArray<Real> = gpu.array(rows * 2 * inner)?;
            let (by_u, by_source): (DeviceArray<Real>, DeviceArray<Real>) =
                (gpu.array(rows * inner)?, gpu.array(rows * inner)?);
            let by_bc: DeviceArray<f32> = gpu.array(blocks * rows * 2 * state)?;
            let by_a: DeviceArray<f32> = gpu.array(images * inner * state)?;
            let by_skip: DeviceArray<f32> = gpu.array(images * inner)?;
            launch!(
                gpu,
                "scan_back",
                grid,
                &by_xz,
                &by_u,
                &by_source,
                &by_bc,
                &by_a,
                &by_skip,
                &g,
                before.as_ref(),
                xz.values(),
                &u,
                &source,
                &sb,
                &projected,
                &a,
                &d,
                &order,
                tokens,
                inner,
                state,
                rank
            )?;
            drop(g);
            let by_projected: DeviceArray<Real> = gpu.array(rows * columns)?;
            let width = 2 * state;
            launch!(gpu, "scan_bc_total", each(rows * width), &by_projected, &by_bc, blocks, rows, width, rank)?;
            drop(by_bc);
            let source_rows = View::rows(&by_source, inner);
            gpu.multiply(
                source_rows,
                View::rows(step.values(), rank),
                View::rows(&by_projected, columns),
                Multiply::new([rows, rank], inner),
            )?;
            let projected_rows = View::rows(&by_projected, columns);
            if let Some(sum) = &step.parameter()?.gradient {
                let multiply = Multiply::slope([inner, rank], rows);
                gpu.multiply(
                    source_rows.transposed(),
                    View::rows(&projected, columns),
                    View::rows(sum, rank),
                    multiply,
                )?;
            }
            if let Some(sum) = &step_bias.parameter()?.gradient {
                gpu.add_columns(sum, &by_source)?;
            }
            if let Some(sum) = &projection.parameter()?.gradient {
                let multiply = Multiply::slope([columns, inner], rows);
                gpu.multiply(projected_rows.transposed(), View::rows(&u, inner), View::rows(sum, inner), multiply)?;
            }
            let multiply = Multiply { is_added: true, ..Multiply::new([rows, inner], columns) };
            gpu.multiply(projected_rows, View::rows(projection.values(), inner), View::rows(&by_u, inner), multiply)?;
            if let Some(sum) = &a_log.parameter()?.gradient {
                gpu.add_parts(sum, &by_a, images)?;
            }
            if let Some(sum) = &skip.parameter()?.gradient {
                gpu.add_parts(sum, &by_skip, images)?;
            }
            let chunks = tokens.div_ceil(CONVOLVED);
            let parts: DeviceArray<f32> = gpu.array(images * chunks * (tap_count + 1) * inner)?;
            let grid = Launch { blocks: [inner.div_ceil(128) as u32, chunks as u32, images as u32], threads: 128 };
            launch!(
                gpu,
                "causal_back",
                grid,
                &by_xz,
                &parts,
                &by_u,
                xz.values(),
                &w,
                &b,
                &order,
                tokens,
                inner,
                tap_count,
                CONVOLVED
            )?;
            if let (Some(by_taps), Some(by_bias)) = (&taps.parameter()?.gradient, &bias.parameter()?.gradient) {
                let blocks = (inner * (tap_count + 1)).div_ceil(32);
                let (grid, count) = (Launch { blocks: [blocks as u32, 1, 1], threads: 256 }, images * chunks);
                launch!(gpu, "causal_total", grid, by_taps, by_bias, &parts, count, inner, tap_count)?;
            }
            slopes.give(&xz, by_xz)
        });
        Ok((out, back))
    })
}
