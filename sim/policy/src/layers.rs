//! Networks of safetensors files: a normaliser, at most one GRU, and linear layers.
//!
//! Names are those of PyTorch: `normaliser.mean` and `normaliser.std`; `gru.weight_ih_l0`, `gru.weight_hh_l0`, `gru.bias_ih_l0` and
//! `gru.bias_hh_l0`; then `layers.0.weight` (outputs x inputs), `layers.0.bias`, `layers.1.weight` and so on.

use safetensors::tensor::{Dtype, SafeTensors};

use crate::fields::Fields;

/// Most numbers of a network's inputs, outputs and hidden layers.
const WIDEST: usize = 1 << 14;

/// Function that follows each linear layer but the last.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Activation {
    Identity,
    Elu,
    Relu,
    Tanh,
    Sigmoid,
    Silu,
}

const ACTIVATIONS: [(&str, Activation); 6] = [
    ("identity", Activation::Identity),
    ("elu", Activation::Elu),
    ("relu", Activation::Relu),
    ("tanh", Activation::Tanh),
    ("sigmoid", Activation::Sigmoid),
    ("silu", Activation::Silu),
];

impl Activation {
    fn read(fields: &Fields, name: &str) -> Result<Self, String> {
        let word = fields.words(name)?.join(",");
        let names = || ACTIVATIONS.map(|(name, _)| name).join(", ");
        let known = ACTIVATIONS.iter().find(|(known, _)| *known == word).map(|(_, activation)| *activation);
        known.ok_or_else(|| format!("{name} is {word:?}; choose of {}", names()))
    }

    fn of(self, x: f32) -> f32 {
        match self {
            Self::Identity => x,
            Self::Elu => {
                if x > 0.0 {
                    x
                } else {
                    x.exp_m1()
                }
            }
            Self::Relu => x.max(0.0),
            Self::Tanh => x.tanh(),
            Self::Sigmoid => sigmoid(x),
            Self::Silu => x * sigmoid(x),
        }
    }
}

fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// A matrix by rows, with an addend for each.
#[derive(Debug, Clone, PartialEq)]
struct Linear {
    weight: Vec<f32>,
    bias: Vec<f32>,
    inputs: usize,
}

impl Linear {
    fn of(&self, input: &[f32]) -> Vec<f32> {
        let rows = self.weight.chunks_exact(self.inputs.max(1)).zip(&self.bias);
        rows.map(|(row, bias)| bias + row.iter().zip(input).map(|(w, x)| w * x).sum::<f32>()).collect()
    }
}

/// GRU of PyTorch, whose gates stand in the order reset, update, new.
#[derive(Debug, Clone, PartialEq)]
struct Gru {
    input: Linear,
    hidden: Linear,
}

impl Gru {
    fn size(&self) -> usize {
        self.hidden.inputs
    }

    /// Takes an input, and changes the state.
    fn step(&self, input: &[f32], state: &mut [f32]) {
        let (of_input, of_state, size) = (self.input.of(input), self.hidden.of(state), self.size());
        let at = |gates: &[f32], gate: usize, k: usize| gates.get(gate * size + k).copied().unwrap_or(0.0);
        for (k, h) in state.iter_mut().enumerate() {
            let reset = sigmoid(at(&of_input, 0, k) + at(&of_state, 0, k));
            let update = sigmoid(at(&of_input, 1, k) + at(&of_state, 1, k));
            let new = (at(&of_input, 2, k) + reset * at(&of_state, 2, k)).tanh();
            *h = (1.0 - update) * new + update * *h;
        }
    }
}

/// A network of a safetensors file.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Layers {
    mean: Vec<f32>,
    std: Vec<f32>,
    /// Greatest absolute value of a normalised input.
    clip: f32,
    gru: Option<Gru>,
    layers: Vec<Linear>,
    activation: Activation,
    last: Activation,
}

impl Layers {
    /// Reads the tensors of a file.
    ///
    /// # Errors
    /// The tensor or field that is missing, has a wrong shape, or holds a number that is not finite.
    pub(crate) fn read(bytes: &[u8], fields: &Fields) -> Result<Self, String> {
        let tensors = SafeTensors::deserialize(bytes).map_err(|e| format!("it is not a safetensors file: {e}"))?;
        let names = tensors.names();
        let known = |name: &&str| ["normaliser.", "gru.", "layers."].iter().any(|begin| name.starts_with(begin));
        if let Some(name) = names.iter().find(|name| !known(name)) {
            return Err(format!(
                "{name}: there is no such tensor in a policy; its names begin with normaliser., gru. or layers."
            ));
        }
        let has = |name: &str| names.contains(&name);
        let gru = match names.iter().any(|name| name.starts_with("gru.")) {
            true => {
                let input = linear(&tensors, "gru.weight_ih_l0", "gru.bias_ih_l0")?;
                let hidden = linear(&tensors, "gru.weight_hh_l0", "gru.bias_hh_l0")?;
                let gates = 3 * hidden.inputs;
                if hidden.bias.len() != gates || input.bias.len() != gates {
                    return Err(format!(
                        "gru.weight_hh_l0: the gates of a state of {} numbers have {gates} rows",
                        hidden.inputs
                    ));
                }
                if let Some(name) = names.iter().find(|name| name.starts_with("gru.") && !name.ends_with("_l0")) {
                    return Err(format!("{name}: a policy has one layer of GRU in one direction"));
                }
                Some(Gru { input, hidden })
            }
            false => None,
        };
        let mut layers: Vec<Linear> = Vec::new();
        while has(&format!("layers.{}.weight", layers.len())) {
            let k = layers.len();
            let layer = linear(&tensors, &format!("layers.{k}.weight"), &format!("layers.{k}.bias"))?;
            let before = layers.last().map(|layer| layer.bias.len()).or(gru.as_ref().map(Gru::size));
            if let Some(before) = before.filter(|before| *before != layer.inputs) {
                return Err(format!(
                    "layers.{k}.weight: it takes {} numbers; the layer before gives {before}",
                    layer.inputs
                ));
            }
            layers.push(layer);
        }
        if layers.is_empty() {
            return Err("layers.0.weight: the tensor is missing; a policy has at least one linear layer".to_owned());
        }
        let counted = 2 * layers.len() + names.iter().filter(|name| !name.starts_with("layers.")).count();
        if counted != names.len() {
            return Err(format!(
                "layers.{}.weight: the tensor is missing; layers are numbered from 0 without a gap",
                layers.len()
            ));
        }
        let inputs = gru.as_ref().map(|gru| gru.input.inputs).or(layers.first().map(|layer| layer.inputs)).unwrap_or(0);
        let (mean, std, clip) = normaliser(&tensors, &has, fields, inputs)?;
        Ok(Self {
            mean,
            std,
            clip,
            gru,
            layers,
            activation: Activation::read(fields, "activation")?,
            last: if fields.has("output_activation") {
                Activation::read(fields, "output_activation")?
            } else {
                Activation::Identity
            },
        })
    }

    /// Returns the numbers of inputs and outputs.
    pub(crate) fn sizes(&self) -> [usize; 2] {
        [self.mean.len(), self.layers.last().map_or(0, |layer| layer.bias.len())]
    }

    /// Returns the state before the first observation.
    pub(crate) fn first_state(&self) -> Vec<Vec<f32>> {
        self.gru.iter().map(|gru| vec![0.0; gru.size()]).collect()
    }

    /// Returns the action for an observation, and changes the state.
    pub(crate) fn run(&self, observation: &[f32], state: &mut [Vec<f32>]) -> Vec<f32> {
        let normalised = observation.iter().zip(self.mean.iter().zip(&self.std));
        let mut values: Vec<f32> =
            normalised.map(|(x, (mean, std))| ((x - mean) / std).clamp(-self.clip, self.clip)).collect();
        if let Some((gru, state)) = self.gru.as_ref().zip(state.first_mut()) {
            gru.step(&values, state);
            values.clone_from(state);
        }
        for (k, layer) in self.layers.iter().enumerate() {
            let activation = if k + 1 < self.layers.len() { self.activation } else { self.last };
            values = layer.of(&values).into_iter().map(|x| activation.of(x)).collect();
        }
        values
    }

    /// Returns the layers in words.
    pub(crate) fn in_words(&self) -> String {
        let widths: Vec<String> = self.layers.iter().map(|layer| layer.bias.len().to_string()).collect();
        let gru = self.gru.as_ref().map_or(String::new(), |gru| format!("GRU of {}, ", gru.size()));
        format!("{gru}linear layers of {}", widths.join(", "))
    }
}

type Normaliser = (Vec<f32>, Vec<f32>, f32);

fn normaliser(
    tensors: &SafeTensors<'_>,
    has: &dyn Fn(&str) -> bool,
    fields: &Fields,
    inputs: usize,
) -> Result<Normaliser, String> {
    let is_there = has("normaliser.mean") || has("normaliser.std");
    let word = fields.word("normaliser", "tensors")?;
    let clip = match fields.has("normaliser_clip") {
        true => fields.numbers("normaliser_clip", 1, "limits")?.first().map_or(f32::INFINITY, |clip| clip.abs() as f32),
        false => f32::INFINITY,
    };
    match (word.as_str(), is_there) {
        ("none", false) => Ok((vec![0.0; inputs], vec![1.0; inputs], clip)),
        ("none", true) => Err("normaliser is \"none\", and the file has the tensor normaliser.mean; remove one".to_owned()),
        ("tensors", false) => Err(
            "normaliser: the file has neither normaliser.mean nor normaliser.std; store them, or write normaliser = \"none\" if the policy was trained without"
                .to_owned(),
        ),
        ("tensors", true) => {
            let mean = numbers(tensors, "normaliser.mean", &[inputs])?;
            let std = numbers(tensors, "normaliser.std", &[inputs])?;
            match std.iter().find(|std| **std <= 0.0) {
                Some(std) => Err(format!("normaliser.std: {std} is not positive")),
                None => Ok((mean, std, clip)),
            }
        }
        (other, _) => Err(format!("normaliser is {other:?}; choose tensors or none")),
    }
}

/// Reads a matrix and its addends, whose sizes follow from one another.
fn linear(tensors: &SafeTensors<'_>, weight: &str, bias: &str) -> Result<Linear, String> {
    let shape = tensors.tensor(weight).map_err(|_| format!("{weight}: the tensor is missing"))?.shape().to_vec();
    let &[outputs, inputs] = shape.as_slice() else {
        return Err(format!("{weight}: it has {} dimensions, not 2", shape.len()));
    };
    if !(1..=WIDEST).contains(&inputs) || !(1..=3 * WIDEST).contains(&outputs) {
        return Err(format!("{weight}: it is {outputs} x {inputs}; each must be from 1 to {WIDEST}"));
    }
    Ok(Linear { weight: numbers(tensors, weight, &shape)?, bias: numbers(tensors, bias, &[outputs])?, inputs })
}

/// Reads a tensor of 32-bit floating-point numbers with a shape.
fn numbers(tensors: &SafeTensors<'_>, name: &str, shape: &[usize]) -> Result<Vec<f32>, String> {
    let tensor = tensors.tensor(name).map_err(|_| format!("{name}: the tensor is missing"))?;
    if tensor.dtype() != Dtype::F32 {
        return Err(format!("{name}: its numbers are {:?}; store 32-bit floats (F32)", tensor.dtype()));
    }
    if tensor.shape() != shape {
        return Err(format!("{name}: its shape is {:?}; {shape:?} expected", tensor.shape()));
    }
    let number = |bytes: &[u8]| f32::from_le_bytes(bytes.try_into().unwrap_or_default());
    let numbers: Vec<f32> = tensor.data().chunks_exact(4).map(number).collect();
    match numbers.iter().find(|number| !number.is_finite()) {
        Some(number) => Err(format!("{name}: it holds {number}; the weights are damaged, export them again")),
        None => Ok(numbers),
    }
}
