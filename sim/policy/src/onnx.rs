//! Policies as ONNX files.
//!
//! The file is looked through before the runtime sees it: its operators must be among those of policies, its weights finite, its sizes small,
//! and nothing may lie in other files or in nested graphs. The runtime is `rten`, on one thread: a policy is too small for more.

// Why: notes/decisions/simulation.md, "Learnt policies are run by rten, behind a feature".

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, LazyLock};

use rten::{Model, NodeId, RunOptions, ThreadPool, Value};

use crate::fields::Fields;
use crate::wire::{WireFields, WireValue, packed};

/// Operators of policies. None of them makes a tensor whose size only its numbers state, or loads anything.
const OPERATORS: [&str; 59] = [
    "Abs",
    "Add",
    "ArgMax",
    "AveragePool",
    "BatchNormalization",
    "Cast",
    "Clip",
    "Concat",
    "Constant",
    "Conv",
    "Cos",
    "Div",
    "Dropout",
    "Elu",
    "Equal",
    "Erf",
    "Exp",
    "Flatten",
    "GRU",
    "Gather",
    "Gelu",
    "Gemm",
    "GlobalAveragePool",
    "Greater",
    "HardSigmoid",
    "HardSwish",
    "Identity",
    "LSTM",
    "LayerNormalization",
    "LeakyRelu",
    "Less",
    "Log",
    "MatMul",
    "Max",
    "MaxPool",
    "Min",
    "Mul",
    "Neg",
    "Pow",
    "RNN",
    "Reciprocal",
    "ReduceMean",
    "ReduceSum",
    "Relu",
    "Reshape",
    "Selu",
    "Shape",
    "Sigmoid",
    "Sin",
    "Slice",
    "Softmax",
    "Softplus",
    "Split",
    "Sqrt",
    "Squeeze",
    "Sub",
    "Tanh",
    "Transpose",
    "Unsqueeze",
];
/// Longest side of a tensor, and most operators.
const LONGEST: u64 = 1 << 14;
const MOST_OPERATORS: usize = 4096;
/// Numbers of the fields of the messages in onnx.proto3.
mod field {
    pub(super) const MODEL_GRAPH: u64 = 7;
    pub(super) const MODEL_METADATA: u64 = 14;
    pub(super) const MODEL_FUNCTIONS: u64 = 25;
    pub(super) const GRAPH_NODE: u64 = 1;
    pub(super) const GRAPH_INITIALIZER: u64 = 5;
    pub(super) const GRAPH_INPUT: u64 = 11;
    pub(super) const GRAPH_OUTPUT: u64 = 12;
    pub(super) const GRAPH_VALUE: u64 = 13;
    pub(super) const GRAPH_SPARSE: u64 = 15;
    pub(super) const NODE_INPUT: u64 = 1;
    pub(super) const NODE_OPERATOR: u64 = 4;
    pub(super) const NODE_ATTRIBUTE: u64 = 5;
    pub(super) const NODE_DOMAIN: u64 = 7;
    pub(super) const ATTRIBUTE_TENSOR: u64 = 5;
    pub(super) const ATTRIBUTE_GRAPHS: [u64; 4] = [6, 11, 14, 15];
    pub(super) const TENSOR_DIMS: u64 = 1;
    pub(super) const TENSOR_TYPE: u64 = 2;
    pub(super) const TENSOR_FLOATS: u64 = 4;
    pub(super) const TENSOR_NAME: u64 = 8;
    pub(super) const TENSOR_RAW: u64 = 9;
    pub(super) const TENSOR_DOUBLES: u64 = 10;
    pub(super) const TENSOR_EXTERNAL: [u64; 2] = [13, 14];
    pub(super) const VALUE_NAME: u64 = 1;
    pub(super) const VALUE_TYPE: u64 = 2;
    pub(super) const TYPE_TENSOR: u64 = 1;
}
/// Types of numbers in tensors.
const FLOAT: u64 = 1;
const DOUBLE: u64 = 11;

// Why: notes/decisions/simulation.md, "An ONNX file is looked through before the runtime gets it".
/// What is looked up before the runtime gets the file.
#[derive(Debug, Default)]
struct Survey {
    fields: Fields,
    operators: Vec<String>,
    initializers: Vec<String>,
    inputs: Vec<String>,
    outputs: Vec<String>,
    /// Operators that take each graph input, by input name.
    first: Vec<(String, String)>,
}

impl Survey {
    fn read(bytes: &[u8]) -> Result<Self, String> {
        let mut survey = Self::default();
        let mut has_graph = false;
        for part in WireFields::new(bytes) {
            match part? {
                (field::MODEL_GRAPH, graph) if !has_graph => {
                    survey.graph(graph.bytes()?)?;
                    has_graph = true;
                }
                (field::MODEL_GRAPH, _) => return Err("it is damaged: it has two graphs".to_owned()),
                (field::MODEL_METADATA, entry) => {
                    let [name, text] = texts(entry.bytes()?)?;
                    survey.fields.add_metadata(&name, &text)?;
                }
                (field::MODEL_FUNCTIONS, _) => {
                    return Err("it defines operators of its own; export it with standard ones alone".to_owned());
                }
                _ => (),
            }
        }
        if has_graph { Ok(survey) } else { Err("it is damaged, or not an ONNX file: it has no graph".to_owned()) }
    }

    fn graph(&mut self, graph: &[u8]) -> Result<(), String> {
        for part in WireFields::new(graph) {
            match part? {
                (field::GRAPH_NODE, node) => self.node(node.bytes()?)?,
                (field::GRAPH_INITIALIZER, tensor) => self.initializers.push(check_tensor(tensor.bytes()?)?),
                (field::GRAPH_INPUT, value) => self.inputs.push(value_name(value.bytes()?)?),
                (field::GRAPH_OUTPUT, value) => self.outputs.push(value_name(value.bytes()?)?),
                (field::GRAPH_VALUE, value) => drop(value_name(value.bytes()?)?),
                (field::GRAPH_SPARSE, _) => return Err("it has sparse weights; export them dense".to_owned()),
                _ => (),
            }
        }
        if self.operators.len() > MOST_OPERATORS {
            return Err(format!("it has {} operators; at most {MOST_OPERATORS} are possible", self.operators.len()));
        }
        // Old exporters list weights among the inputs.
        self.inputs.retain(|name| !self.initializers.contains(name));
        Ok(())
    }

    fn node(&mut self, node: &[u8]) -> Result<(), String> {
        let (mut operator, mut domain, mut inputs) = (String::new(), String::new(), Vec::new());
        let mut has_graph = false;
        for part in WireFields::new(node) {
            match part? {
                (field::NODE_OPERATOR, name) => operator = name.text()?,
                (field::NODE_DOMAIN, name) => domain = name.text()?,
                (field::NODE_INPUT, name) => inputs.push(name.text()?),
                (field::NODE_ATTRIBUTE, attribute) => {
                    for part in WireFields::new(attribute.bytes()?) {
                        match part? {
                            (field::ATTRIBUTE_TENSOR, tensor) => drop(check_tensor(tensor.bytes()?)?),
                            (number, _) if field::ATTRIBUTE_GRAPHS.contains(&number) => has_graph = true,
                            _ => (),
                        }
                    }
                }
                _ => (),
            }
        }
        if !["", "ai.onnx"].contains(&domain.as_str()) {
            return Err(format!(
                "operator {operator} of {domain} is not a standard one; export the policy without custom operators"
            ));
        }
        if has_graph || !OPERATORS.contains(&operator.as_str()) {
            return Err(format!(
                "operator {operator} is not among those of policies; they are {}",
                OPERATORS.join(", ")
            ));
        }
        self.first.extend(inputs.into_iter().map(|input| (input, operator.clone())));
        self.operators.push(operator);
        Ok(())
    }
}

/// Returns the two texts of a message: key and value.
fn texts(message: &[u8]) -> Result<[String; 2], String> {
    let mut texts = [String::new(), String::new()];
    for part in WireFields::new(message) {
        match part? {
            (1, key) => texts[0] = key.text()?,
            (2, value) => texts[1] = value.text()?,
            _ => (),
        }
    }
    Ok(texts)
}

/// Returns the name of an input or output, which must be a tensor.
fn value_name(value: &[u8]) -> Result<String, String> {
    let mut name = String::new();
    for part in WireFields::new(value) {
        match part? {
            (field::VALUE_NAME, text) => name = text.text()?,
            (field::VALUE_TYPE, kind) => {
                for part in WireFields::new(kind.bytes()?) {
                    let (number, _) = part?;
                    // Sequences nest without end.
                    if (2..=9).contains(&number) && number != 6 && number != field::TYPE_TENSOR {
                        return Err(format!("{name}: it is no tensor; a policy takes and gives tensors"));
                    }
                }
            }
            _ => (),
        }
    }
    Ok(name)
}

/// Checks the size and the numbers of a tensor, and returns its name.
fn check_tensor(tensor: &[u8]) -> Result<String, String> {
    let (mut name, mut kind) = (String::new(), FLOAT);
    for part in WireFields::new(tensor) {
        match part? {
            (field::TENSOR_NAME, text) => name = text.text()?,
            (field::TENSOR_TYPE, WireValue::Number(number)) => kind = number,
            _ => (),
        }
    }
    let finite = |holds: bool| match holds {
        true => Ok(()),
        false => {
            Err(format!("{name}: it holds a number that is not finite; the weights are damaged, export them again"))
        }
    };
    let floats =
        |bytes: &[u8]| bytes.chunks_exact(4).all(|b| f32::from_le_bytes(b.try_into().unwrap_or_default()).is_finite());
    let doubles =
        |bytes: &[u8]| bytes.chunks_exact(8).all(|b| f64::from_le_bytes(b.try_into().unwrap_or_default()).is_finite());
    let short = |side: u64| match side <= LONGEST {
        true => Ok(()),
        false => Err(format!("{name}: a side of {side} numbers is too long; at most {LONGEST} are possible")),
    };
    for part in WireFields::new(tensor) {
        match part? {
            (field::TENSOR_DIMS, WireValue::Number(side)) => short(side)?,
            (field::TENSOR_DIMS, sides) => packed(sides.bytes()?)?.into_iter().try_for_each(short)?,
            (field::TENSOR_FLOATS, WireValue::Fixed32(bytes)) => finite(f32::from_le_bytes(bytes).is_finite())?,
            (field::TENSOR_FLOATS, list) => finite(floats(list.bytes()?))?,
            (field::TENSOR_DOUBLES, list) => finite(doubles(list.bytes()?))?,
            (field::TENSOR_RAW, list) if kind == FLOAT => finite(floats(list.bytes()?))?,
            (field::TENSOR_RAW, list) if kind == DOUBLE => finite(doubles(list.bytes()?))?,
            (number, value) if field::TENSOR_EXTERNAL.contains(&number) && value != WireValue::Number(0) => {
                return Err(format!("{name}: its numbers lie in another file; export the policy as one file"));
            }
            _ => (),
        }
    }
    Ok(name)
}

/// An input that the network remembers from an output.
#[derive(Debug)]
struct Memory {
    input: NodeId,
    output: NodeId,
    shape: Vec<usize>,
}

/// A network of an ONNX file.
pub(crate) struct OnnxNetwork {
    model: Model,
    observation: NodeId,
    /// Shape of the observation; its last side is `None` if the file leaves it open.
    size: Option<usize>,
    rank: usize,
    action: NodeId,
    actions: Option<usize>,
    memory: Vec<Memory>,
    words: String,
    notes: Vec<String>,
}

impl std::fmt::Debug for OnnxNetwork {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("OnnxNetwork").field("words", &self.words).finish_non_exhaustive()
    }
}

impl OnnxNetwork {
    /// Reads a file and its metadata.
    ///
    /// # Errors
    /// The operator, tensor, input or output that a policy cannot have.
    pub(crate) fn read(bytes: Vec<u8>) -> Result<(Fields, Self), String> {
        let survey = Survey::read(&bytes)?;
        let model = guarded(|| Model::load(bytes).map_err(|e| format!("the runtime cannot load it: {e}")))?;
        let ids = |names: &[String]| -> Result<Vec<(String, NodeId)>, String> {
            names
                .iter()
                .map(|name| Ok((name.clone(), model.node_id(name).map_err(|e| format!("{name}: {e}"))?)))
                .collect()
        };
        let (mut inputs, mut outputs) = (ids(&survey.inputs)?, ids(&survey.outputs)?);
        let mut memory = Vec::new();
        // rsl_rl's names: h_in and h_out, c_in and c_out.
        while let Some(k) = inputs.iter().position(|(name, _)| name.ends_with("_in")) {
            let (name, input) = inputs.remove(k);
            let partner = format!("{}_out", name.trim_end_matches("_in"));
            let at = outputs.iter().position(|(name, _)| *name == partner);
            let at =
                at.ok_or_else(|| format!("{name}: the network remembers this input, and has no output {partner}"))?;
            let shape = sides(&model, input).ok_or_else(|| format!("{name}: its shape is unknown"))?;
            // An open side is the number of environments.
            let shape: Vec<usize> = shape.into_iter().map(|side| side.unwrap_or(1)).collect();
            if shape.iter().any(|side| !(1..=LONGEST as usize).contains(side))
                || shape.iter().product::<usize>() > 1 << 20
            {
                return Err(format!("{name}: the shape {shape:?} is too large; it is the state of one hand"));
            }
            memory.push(Memory { input, output: outputs.remove(at).1, shape });
        }
        let one = |found: &[(String, NodeId)], what: &str| match found {
            [(_, one)] => Ok(*one),
            [] => Err(format!("it has no {what}")),
            [_, (other, _), ..] => {
                Err(format!("{other}: a policy has one {what}, and pairs such as h_in and h_out that it remembers"))
            }
        };
        let (observation, action) = (one(&inputs, "input")?, one(&outputs, "output")?);
        let shape = sides(&model, observation).ok_or("the shape of its input is unknown")?;
        let size = match shape.as_slice() {
            [None | Some(1), size] | [size] => *size,
            other => {
                return Err(format!(
                    "its input has {} dimensions, or is for several hands; export it for observations of shape (1, N)",
                    other.len()
                ));
            }
        };
        let name = inputs.first().map_or("", |(name, _)| name);
        let is_normalised = survey.first.iter().any(|(input, operator)| input == name && operator == "Sub");
        let notes = (!is_normalised)
            .then(|| "no normaliser in front of the network: right only if it was trained without one".to_owned());
        let network = Self {
            size,
            rank: shape.len(),
            actions: sides(&model, action).and_then(|shape| shape.last().copied().flatten()),
            words: format!("ONNX, {} operators: {}", survey.operators.len(), survey.operators.join(", ")),
            notes: notes.into_iter().collect(),
            model,
            observation,
            action,
            memory,
        };
        Ok((survey.fields, network))
    }

    pub(crate) fn sizes(&self) -> [Option<usize>; 2] {
        [self.size, self.actions]
    }

    pub(crate) fn first_state(&self) -> Vec<Vec<f32>> {
        self.memory.iter().map(|memory| vec![0.0; memory.shape.iter().product()]).collect()
    }

    pub(crate) fn in_words(&self) -> String {
        self.words.clone()
    }

    pub(crate) fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }

    /// Returns the action for an observation, and changes the state.
    pub(crate) fn run(&self, observation: &[f32], state: &mut [Vec<f32>]) -> Result<Vec<f32>, String> {
        /// Threads are slower than one for networks of this size.
        static POOL: LazyLock<Arc<ThreadPool>> = LazyLock::new(|| Arc::new(ThreadPool::with_num_threads(1)));
        let failed = |e: &dyn std::fmt::Display| format!("the network cannot be run: {e}");
        let shape = if self.rank == 1 { vec![observation.len()] } else { vec![1, observation.len()] };
        let value = |shape: &[usize], data: &[f32]| Value::from_shape(shape, data.to_vec()).map_err(|e| failed(&e));
        let mut inputs = vec![(self.observation, value(&shape, observation)?.into())];
        for (memory, state) in self.memory.iter().zip(state.iter()) {
            inputs.push((memory.input, value(&memory.shape, state)?.into()));
        }
        let outputs: Vec<NodeId> =
            [self.action].into_iter().chain(self.memory.iter().map(|memory| memory.output)).collect();
        let mut options = RunOptions::default();
        options.thread_pool = Some(Arc::clone(&POOL));
        let values = guarded(|| self.model.run(inputs, &outputs, Some(options)).map_err(|e| failed(&e)))?;
        let numbers = |value: Value| match value {
            Value::FloatTensor(tensor) => Ok(tensor.into_data()),
            _ => Err(failed(&"an output is not of 32-bit floats")),
        };
        let mut values = values.into_iter().map(numbers).collect::<Result<Vec<Vec<f32>>, String>>()?;
        let next = values.split_off(1.min(values.len()));
        if next.iter().zip(state.iter()).any(|(next, state)| next.len() != state.len()) {
            return Err(failed(&"a state changes its size"));
        }
        for (state, next) in state.iter_mut().zip(next) {
            *state = next;
        }
        values.pop().ok_or_else(|| failed(&"it gives nothing"))
    }
}

/// Returns the sides of a value; `None` for those that the file leaves open.
fn sides(model: &Model, id: NodeId) -> Option<Vec<Option<usize>>> {
    let side = |side: rten::Dimension| match side {
        rten::Dimension::Fixed(side) => Some(side),
        rten::Dimension::Symbolic(_) => None,
    };
    Some(model.node_info(id)?.shape()?.into_iter().map(side).collect())
}

/// Calls the runtime, which panics on some damaged files.
fn guarded<T>(call: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(call))
        .unwrap_or_else(|_| Err("the runtime cannot take it; the file is damaged".to_owned()))
}
