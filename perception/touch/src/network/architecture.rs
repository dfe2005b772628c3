//! Architectures with their hyper-parameters.

use serde::{Deserialize, Serialize};

/// Network with all its hyper-parameters. In a configuration `name` selects the network; missing hyper-parameters have the values of the
/// preset.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "name", rename_all = "snake_case")]
pub enum Architecture {
    /// Vision transformer with a DPT decoder: the original tactile transformer.
    Vit(Vit),
    /// Mamba blocks with a DPT decoder.
    Mamba(Mamba),
    /// Mamba blocks with an MLP each, and fixed positions.
    RobustMamba(RobustMamba),
    /// Attention in shifted windows on a pyramid of four maps, with the decoder of `vit`.
    Swin(Swin),
    /// Convolutions of 7 x 7 pixels on such a pyramid.
    #[serde(rename = "convnext")]
    ConvNext(ConvNext),
    /// Convolutions, with Mamba blocks where the map is coarsest: designed for a CPU.
    Default(Pyramid),
}

/// Hyper-parameters of `vit`. The preset is ViT-S/16 with the decoder of the paper.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Vit {
    /// Side of a patch, pixels.
    pub patch: usize,
    /// Channels of a token.
    pub width: usize,
    /// Blocks.
    pub depth: usize,
    /// Heads of attention.
    pub heads: usize,
    /// Hidden channels of an MLP, in widths.
    pub mlp: usize,
    /// Rows and columns of the learned positions.
    pub positions: [usize; 2],
    /// Blocks whose results the decoder sees, from 0, shallow first; as many as it has levels, one to four.
    pub hooks: Vec<usize>,
    /// Channels of the decoder.
    pub channels: usize,
}

impl Default for Vit {
    fn default() -> Self {
        Self {
            patch: 16,
            width: 384,
            depth: 12,
            heads: 6,
            mlp: 4,
            positions: [20, 15],
            hooks: vec![2, 5, 8, 11],
            channels: 128,
        }
    }
}

/// Hyper-parameters of `mamba`. The preset has the 12 blocks of the original that reach its output.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Mamba {
    /// Side of a patch, pixels.
    pub patch: usize,
    /// Channels of a token.
    pub width: usize,
    /// Blocks.
    pub depth: usize,
    /// States of each channel.
    pub state: usize,
    /// Channels of a scan, in widths.
    pub expand: usize,
    /// Taps of the causal convolution.
    pub taps: usize,
    /// Orders of the scans, which the blocks take in turn.
    pub scans: Vec<ScanOrder>,
    /// Rows and columns of the learned positions.
    pub positions: [usize; 2],
    /// Blocks whose results the decoder sees, from 0, shallow first; as many as it has levels, one to four.
    pub hooks: Vec<usize>,
    /// Channels of the decoder.
    pub channels: usize,
}

impl Default for Mamba {
    fn default() -> Self {
        Self {
            patch: 16,
            width: 384,
            depth: 12,
            state: 16,
            expand: 2,
            taps: 4,
            scans: vec![ScanOrder::Rows],
            positions: [20, 15],
            hooks: vec![2, 5, 8, 11],
            channels: 128,
        }
    }
}

/// Hyper-parameters of `robust_mamba`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RobustMamba {
    /// Side of a patch, pixels.
    pub patch: usize,
    /// Channels of a token, a multiple of 4.
    pub width: usize,
    /// Blocks.
    pub depth: usize,
    /// States of each channel.
    pub state: usize,
    /// Channels of a scan, in widths.
    pub expand: usize,
    /// Taps of the causal convolution.
    pub taps: usize,
    /// Hidden channels of an MLP, in widths.
    pub mlp: usize,
    /// Orders of the scans, which the blocks take in turn.
    pub scans: Vec<ScanOrder>,
    /// Blocks whose results the decoder sees, from 0, shallow first; as many as it has levels, one to four.
    pub hooks: Vec<usize>,
    /// Channels of the decoder.
    pub channels: usize,
}

impl Default for RobustMamba {
    fn default() -> Self {
        Self {
            patch: 16,
            width: 384,
            depth: 12,
            state: 16,
            expand: 2,
            taps: 4,
            mlp: 4,
            scans: vec![ScanOrder::Rows],
            hooks: vec![2, 5, 8, 11],
            channels: 128,
        }
    }
}

// Why: notes/decisions/touch.md, "`swin` and `convnext` are Swin-T and ConvNeXt-T".
/// Hyper-parameters of `swin`. The preset is Swin-T, whose encoder costs as much as that of ViT-S/16 at 224 x 224.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Swin {
    /// Channels at 1/4, 1/8, 1/16 and 1/32 of the input's size.
    pub widths: [usize; 4],
    /// Blocks at each of these sizes; the second, fourth and so on of them shift their windows.
    pub depths: [usize; 4],
    /// Heads of attention at each of these sizes.
    pub heads: [usize; 4],
    /// Side of a window, tokens.
    pub window: usize,
    /// Hidden channels of an MLP, in widths.
    pub mlp: usize,
    /// Channels of the decoder.
    pub channels: usize,
}

impl Default for Swin {
    fn default() -> Self {
        let widths = [96, 192, 384, 768];
        Self { widths, depths: [2, 2, 6, 2], heads: [3, 6, 12, 24], window: 7, mlp: 4, channels: 128 }
    }
}

/// Hyper-parameters of `convnext`. The preset is ConvNeXt-T, whose encoder costs as much as that of ViT-S/16 at 224 x 224.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ConvNext {
    /// Channels at 1/4, 1/8, 1/16 and 1/32 of the input's size.
    pub widths: [usize; 4],
    /// Blocks at each of these sizes.
    pub depths: [usize; 4],
    /// Hidden channels of an MLP, in widths.
    pub mlp: usize,
    /// Channels of the decoder.
    pub channels: usize,
}

impl Default for ConvNext {
    fn default() -> Self {
        Self { widths: [96, 192, 384, 768], depths: [3, 3, 9, 3], mlp: 4, channels: 128 }
    }
}

/// Hyper-parameters of `default`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Pyramid {
    /// Channels at 1/2, 1/4, 1/8 and 1/16 of the input's size.
    pub widths: [usize; 4],
    /// Mamba blocks.
    pub depth: usize,
    /// States of each channel.
    pub state: usize,
    /// Channels of a scan, in widths.
    pub expand: usize,
    /// Taps of the causal convolution.
    pub taps: usize,
    /// Orders of the scans, which the blocks take in turn.
    pub scans: Vec<ScanOrder>,
}

impl Default for Pyramid {
    fn default() -> Self {
        Self { widths: [16, 32, 64, 128], depth: 6, state: 16, expand: 2, taps: 4, scans: ScanOrder::ALL.to_vec() }
    }
}

/// Order in which a Mamba block visits the tokens of an image. Tokens without a patch come last.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ScanOrder {
    /// Row by row from the upper left.
    Rows,
    /// `Rows` backwards, from the lower right.
    RowsReversed,
    /// Column by column from the upper left.
    Columns,
    /// `Columns` backwards, from the lower right.
    ColumnsReversed,
}

impl ScanOrder {
    /// All orders, in the sequence of the preset `default`.
    pub const ALL: [Self; 4] = [Self::Rows, Self::RowsReversed, Self::Columns, Self::ColumnsReversed];

    /// Returns the indices of `rows` by `columns` tokens, numbered row by row, in this order.
    pub fn order(self, rows: usize, columns: usize) -> Vec<usize> {
        let mut order: Vec<usize> = match self {
            Self::Rows | Self::RowsReversed => (0..rows * columns).collect(),
            Self::Columns | Self::ColumnsReversed => {
                (0..columns).flat_map(|u| (0..rows).map(move |v| v * columns + u)).collect()
            }
        };
        if matches!(self, Self::RowsReversed | Self::ColumnsReversed) {
            order.reverse();
        }
        order
    }
}

/// Reason that an architecture cannot be built or does not exist.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum UnknownNetwork {
    /// No preset has this name.
    #[error("unknown network {0:?}: choose vit, mamba, robust_mamba, swin, convnext or default")]
    Name(String),
    /// A hyper-parameter is invalid.
    #[error("network {network}: {problem}")]
    Parameter {
        /// Name of the network.
        network: &'static str,
        /// Hyper-parameter, fault and range.
        problem: String,
    },
}

/// Largest value of a hyper-parameter: a larger one means a damaged file.
const LARGEST: usize = 1 << 14;

impl Architecture {
    /// Names of the presets.
    pub const NAMES: [&'static str; 6] = ["vit", "mamba", "robust_mamba", "swin", "convnext", "default"];

    /// Returns the preset of a name.
    ///
    /// # Errors
    /// [`UnknownNetwork::Name`] if no preset has the name; it lists the names.
    pub fn preset(name: &str) -> Result<Self, UnknownNetwork> {
        match name {
            "vit" => Ok(Self::Vit(Vit::default())),
            "mamba" => Ok(Self::Mamba(Mamba::default())),
            "robust_mamba" => Ok(Self::RobustMamba(RobustMamba::default())),
            "swin" => Ok(Self::Swin(Swin::default())),
            "convnext" => Ok(Self::ConvNext(ConvNext::default())),
            "default" => Ok(Self::Default(Pyramid::default())),
            _ => Err(UnknownNetwork::Name(name.to_owned())),
        }
    }

    /// Returns the name of the kind of network.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Vit(_) => "vit",
            Self::Mamba(_) => "mamba",
            Self::RobustMamba(_) => "robust_mamba",
            Self::Swin(_) => "swin",
            Self::ConvNext(_) => "convnext",
            Self::Default(_) => "default",
        }
    }

    /// Returns the stride, pixels: the sides of an input are multiples of it.
    pub fn stride(&self) -> usize {
        match self {
            Self::Vit(vit) => vit.patch,
            Self::Mamba(mamba) => mamba.patch,
            Self::RobustMamba(robust) => robust.patch,
            Self::Swin(_) | Self::ConvNext(_) => 4,
            Self::Default(_) => 16,
        }
    }

    /// Returns the size to which an image of `[height, width]` is resized before it enters: the next multiples of the stride.
    pub fn fit(&self, size: [usize; 2]) -> [usize; 2] {
        size.map(|side| side.next_multiple_of(self.stride()).max(self.stride()))
    }

    /// Checks that the hyper-parameters lie in their ranges and fit together.
    ///
    /// # Errors
    /// [`UnknownNetwork::Parameter`] names the first invalid one.
    pub fn check(&self) -> Result<(), UnknownNetwork> {
        let parameter = |problem: String| Err(UnknownNetwork::Parameter { network: self.name(), problem });
        let invalid = |names: &[&'static str], values: &[usize]| {
            let mut sizes = names.iter().copied().zip(values.iter().copied());
            sizes.find(|(_, value)| !(1..=LARGEST).contains(value))
        };
        let invalid = match *self {
            Self::Vit(Vit { width, heads, mlp, channels, positions: [rows, columns], .. }) => invalid(
                &["width", "heads", "mlp", "channels", "positions", "positions"],
                &[width, heads, mlp, channels, rows.min(columns), rows.max(columns)],
            ),
            Self::Mamba(Mamba { width, state, expand, taps, channels, positions: [rows, columns], .. }) => invalid(
                &["width", "state", "expand", "taps", "channels", "positions", "positions"],
                &[width, state, expand, taps, channels, rows.min(columns), rows.max(columns)],
            ),
            Self::RobustMamba(RobustMamba { width, state, expand, taps, mlp, channels, .. }) => invalid(
                &["width", "state", "expand", "taps", "mlp", "channels"],
                &[width, state, expand, taps, mlp, channels],
            ),
            Self::Swin(Swin { widths, depths, heads, window, mlp, channels }) => invalid(
                &[["widths"; 4], ["depths"; 4], ["heads"; 4], ["window", "mlp", "channels", "channels"]].concat(),
                &[widths, depths, heads, [window, mlp, channels, channels]].concat(),
            ),
            Self::ConvNext(ConvNext { widths, depths, mlp, channels }) => invalid(
                &[["widths"; 4], ["depths"; 4], ["mlp", "mlp", "channels", "channels"]].concat(),
                &[widths, depths, [mlp, mlp, channels, channels]].concat(),
            ),
            Self::Default(Pyramid { widths: [a, b, c, d], state, expand, taps, .. }) => invalid(
                &["widths", "widths", "widths", "widths", "state", "expand", "taps"],
                &[a, b, c, d, state, expand, taps],
            ),
        };
        if let Some((name, value)) = invalid {
            return parameter(format!("{name} is {value}; it must lie between 1 and {LARGEST}"));
        }
        let shared = match self {
            Self::Vit(Vit { width, heads, .. }) => vec![(*width, *heads)],
            Self::Swin(Swin { widths, heads, .. }) => widths.iter().copied().zip(heads.iter().copied()).collect(),
            _ => vec![],
        };
        if let Some((width, heads)) = shared.into_iter().find(|(width, heads)| width % heads != 0) {
            return parameter(format!("its width {width} cannot be shared by {heads} heads"));
        }
        if let Self::RobustMamba(RobustMamba { width, .. }) = self
            && width % 4 != 0
        {
            return parameter(format!("its width {width} must be a multiple of 4"));
        }
        if let Self::Mamba(Mamba { scans, .. })
        | Self::RobustMamba(RobustMamba { scans, .. })
        | Self::Default(Pyramid { scans, .. }) = self
            && scans.is_empty()
        {
            return parameter("scans is empty; name one order at least".to_owned());
        }
        if let Self::Default(pyramid) = self {
            return if pyramid.depth <= LARGEST { Ok(()) } else { parameter(format!("depth is over {LARGEST}")) };
        }
        let (patch, depth, hooks) = match self {
            Self::Vit(v) => (v.patch, v.depth, &v.hooks),
            Self::Mamba(m) => (m.patch, m.depth, &m.hooks),
            Self::RobustMamba(m) => (m.patch, m.depth, &m.hooks),
            Self::Swin(_) | Self::ConvNext(_) | Self::Default(_) => return Ok(()),
        };
        if ![8, 16, 32].contains(&patch) {
            return parameter(format!("its patch is {patch}; choose 8, 16 or 32"));
        }
        if !(1..=4).contains(&hooks.len()) || !hooks.is_sorted() || hooks.last().is_none_or(|&last| last + 1 != depth) {
            // Blocks behind the last hook would cost time without effect.
            return parameter(format!(
                "hooks {hooks:?} must be one to four of the {depth} blocks from 0, shallow first, the last of them block {}",
                depth.saturating_sub(1)
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_survive_json_and_fill_gaps() {
        for name in Architecture::NAMES {
            let preset = Architecture::preset(name).unwrap();
            preset.check().unwrap();
            let json = serde_json::to_string(&preset).unwrap();
            assert_eq!(serde_json::from_str::<Architecture>(&json).unwrap(), preset);
            let short = format!("{{\"name\": \"{name}\"}}");
            assert_eq!(serde_json::from_str::<Architecture>(&short).unwrap(), preset);
            let typo = format!("{{\"name\": \"{name}\", \"widht\": 3}}");
            assert!(serde_json::from_str::<Architecture>(&typo).is_err());
        }
        let error = Architecture::preset("resnet").unwrap_err().to_string();
        assert!(Architecture::NAMES.iter().all(|name| error.contains(name)), "{error}");
    }

    #[test]
    fn senseless_parameters_are_named() {
        let hooks = Architecture::Vit(Vit { hooks: vec![3, 12], ..Vit::default() });
        assert!(hooks.check().unwrap_err().to_string().contains("[3, 12]"));
        let scans = Architecture::Default(Pyramid { scans: vec![], ..Pyramid::default() });
        assert!(scans.check().unwrap_err().to_string().contains("scans"));
        let wide = Architecture::Default(Pyramid { widths: [1, 2, 0, 4], ..Pyramid::default() });
        assert!(wide.check().unwrap_err().to_string().contains("widths"));
        let heads = Architecture::Swin(Swin { heads: [3, 6, 11, 24], ..Swin::default() });
        assert!(heads.check().unwrap_err().to_string().contains("11 heads"));
        let depths = Architecture::ConvNext(ConvNext { depths: [3, 3, 0, 3], ..ConvNext::default() });
        assert!(depths.check().unwrap_err().to_string().contains("depths"));
    }

    #[test]
    fn scans_visit_every_token_once() {
        assert_eq!(ScanOrder::Columns.order(2, 3), [0, 3, 1, 4, 2, 5]);
        assert_eq!(ScanOrder::ColumnsReversed.order(2, 3), [5, 2, 4, 1, 3, 0]);
        for scan in ScanOrder::ALL {
            let mut order = scan.order(5, 7);
            order.sort_unstable();
            assert!(order.into_iter().eq(0..35));
        }
    }

    #[test]
    fn sizes_are_rounded_up() {
        assert_eq!(Architecture::preset("default").unwrap().fit([320, 241]), [320, 256]);
    }
}
