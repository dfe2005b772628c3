//! Forward pass of `default`.

use ::image::RgbImage;

use super::image::{load, store};
use super::layers::{Convolution, Norm, Unit, Up};
use super::mamba::{self, Mamba, MambaBuffers};
use super::map::FeatureMap;
use super::pass::{Forward, Prediction};
use crate::network::{self, ScanOrder, Weights};
use mvt_products::Instructions;
use mvt_products::multiply::{LANES, Then};

/// Channels of the input: colours, x and y.
const INPUTS: usize = 5;

/// `default` with packed weights.
#[derive(Debug)]
pub(super) struct Pyramid {
    widths: [usize; 4],
    stem: Convolution,
    downs: [Convolution; 3],
    units: [Unit; 2],
    blocks: Vec<(Norm, Mamba)>,
    /// One per block.
    scans: Vec<ScanOrder>,
    norm: Norm,
    ups: [(Up, Unit); 3],
    head: Convolution,
}

/// Memory of the forward pass.
#[derive(Debug, Clone)]
pub(super) struct PyramidBuffers {
    input: FeatureMap,
    /// Maps at 1/2, 1/4 and 1/8.
    maps: [FeatureMap; 3],
    /// Intermediate results of residual units at these sizes.
    between: [FeatureMap; 3],
    tokens: FeatureMap,
    normed: FeatureMap,
    mamba: MambaBuffers,
    /// One per block.
    orders: Vec<Vec<u32>>,
    /// Output before depth to space by 2.
    output: FeatureMap,
}

impl Pyramid {
    pub(super) fn new(instructions: Instructions, pyramid: &network::Pyramid, weights: &Weights) -> Self {
        let network::Pyramid { widths, depth, scans, .. } = pyramid;
        let stored = widths.map(|width| width.next_multiple_of(LANES));
        let convolution =
            |name: &str, channels, stride| Convolution::new(instructions, weights, name, channels, stride);
        let unit = |name: &str, channels| Unit::new(instructions, weights, name, channels);
        let block = |k| {
            let norm = Norm::new(instructions, weights, &format!("blocks.{k}.norm"));
            (norm, Mamba::new(instructions, weights, &format!("blocks.{k}.mamba")))
        };
        Self {
            widths: *widths,
            stem: convolution("stem", FeatureMap::image([0, 0], INPUTS, 1).channels, 2),
            downs: [0, 1, 2].map(|k| convolution(&format!("encoder.{k}.down"), stored[k], 2)),
            units: [0, 1].map(|k| unit(&format!("encoder.{k}.unit"), stored[k + 1])),
            blocks: (0..*depth).map(block).collect(),
            scans: scans.iter().copied().cycle().take(*depth).collect(),
            norm: Norm::new(instructions, weights, "norm"),
            ups: [0, 1, 2].map(|k| {
                let up = Up::new(instructions, weights, &format!("decoder.{k}.up"), 2);
                (up, unit(&format!("decoder.{k}.unit"), stored[2 - k]))
            }),
            head: convolution("head", stored[0], 1),
        }
    }
}

impl Forward for Pyramid {
    type Buffers = PyramidBuffers;

    fn buffers(&self, [height, width]: [usize; 2]) -> PyramidBuffers {
        let at = |level: usize| [height >> (level + 1), width >> (level + 1)];
        let framed = [0, 1, 2].map(|level| FeatureMap::framed(at(level), self.widths[level]));
        let tokens = FeatureMap::tokens(at(3), 0, self.widths[3]);
        PyramidBuffers {
            input: FeatureMap::image([height, width], INPUTS, 1),
            between: framed.clone(),
            maps: framed,
            normed: tokens.clone(),
            mamba: self.blocks.first().map(|(_, mamba)| mamba.buffers(&tokens)).unwrap_or_default(),
            orders: self.scans.iter().map(|&scan| mamba::order(scan, &tokens)).collect(),
            tokens,
            output: FeatureMap::tokens(at(0), 0, 8),
        }
    }

    fn forward(&self, image: &RgbImage, buffers: &mut PyramidBuffers, words: &mut Vec<u32>, to: &mut Prediction) {
        let PyramidBuffers { input, maps: [half, quarter, eighth], between, tokens, normed, mamba, orders, output } =
            buffers;
        load(image, input);
        self.stem.apply(input, false, Then::Relu, words, half);
        self.downs[0].apply(half, false, Then::Store, words, quarter);
        self.units[0].apply(words, &mut between[1], quarter);
        self.downs[1].apply(quarter, false, Then::Store, words, eighth);
        self.units[1].apply(words, &mut between[2], eighth);
        self.downs[2].apply(eighth, false, Then::Store, words, tokens);
        for ((norm, layer), order) in self.blocks.iter().zip(orders) {
            norm.apply(tokens, normed);
            layer.apply(normed, order, Then::Add, mamba, words, tokens);
        }
        self.norm.apply(tokens, normed);
        let [(up2, unit2), (up1, unit1), (up0, unit0)] = &self.ups;
        up2.apply(normed, Then::Add, words, eighth);
        unit2.apply(words, &mut between[2], eighth);
        up1.apply(eighth, Then::Add, words, quarter);
        unit1.apply(words, &mut between[1], quarter);
        up0.apply(quarter, Then::Add, words, half);
        unit0.apply(words, &mut between[0], half);
        self.head.apply(half, true, Then::Store, words, output);
        store::<2>(output, to);
    }
}
