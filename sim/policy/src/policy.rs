//! A policy: a network with its contract.

use std::ffi::OsStr;
use std::path::Path;
use std::sync::Arc;

use mvt_files::input;
use mvt_gaits::axis::TurnAxis;
use mvt_gaits::controller_file::CORRECTED;
use mvt_gaits::gait::Gait;
use mvt_robot::hand::{Hand, JointAngles};

use crate::contract::{ActionKind, PolicyContract, PolicyStart};
use crate::error::PolicyError;
use crate::fields::Fields;
use crate::layers::Layers;
use crate::network::Network;

/// Largest file of a policy, bytes: 16 million weights, some hundred times those of policies for hands.
const LARGEST_POLICY: u64 = 64 << 20;
/// Largest contract, bytes.
const LARGEST_CONTRACT: u64 = 1 << 20;
/// Greatest action that is believed. Policies give a few units; weights that were exported without a normaliser give thousands.
pub const LARGEST_ACTION: f32 = 100.0;
/// Most numbers of an observation.
const LARGEST_OBSERVATION: usize = 1 << 16;
/// Gravity where no gait suits, m/s^2.
const LEVEL: [f64; 3] = [0.0, 0.0, -9.81];

/// A network with its contract, checked for a hand. It is immutable and shared.
#[derive(Debug)]
pub struct Policy {
    contract: PolicyContract,
    network: Network,
    notes: Vec<String>,
}

/// The policy that the program carries, and its contract.
const CARRIED: (&[u8], &str) =
    (include_bytes!("../assets/corrected.safetensors"), include_str!("../assets/corrected.toml"));

/// Returns whether a text names a policy: a file that ends in .onnx or .safetensors, or [`CORRECTED`].
pub fn is_policy(text: &str) -> bool {
    mvt_gaits::controller_file::is_policy(text)
}

impl Policy {
    /// Reads an ONNX file with mjlab's metadata, or a safetensors file, for a hand. A file of the same name that ends in .toml completes the
    /// contract. Files that can hold code, such as pickles, are not opened. [`CORRECTED`] is the policy that the program carries.
    ///
    /// # Errors
    /// [`PolicyError::File`] names the file and the field that is missing or wrong.
    pub fn read(path: &Path, hand: &Hand) -> Result<Arc<Self>, PolicyError> {
        let failed = |reason: String| PolicyError::File { path: path.to_owned(), reason: one_line(&reason) };
        let (bytes, text) = Self::files(path)?;
        let beside = path.with_extension("toml");
        let sidecar =
            Self::fields(&text).map_err(|reason| PolicyError::File { path: beside, reason: one_line(&reason) })?;
        let (fields, network, notes) = match path.extension().is_some_and(|ending| ending == "onnx") {
            true => read_onnx(bytes, sidecar).map_err(failed)?,
            false => {
                let network = Layers::read(&bytes, &sidecar).map_err(failed)?;
                (sidecar, Network::Layers(network), Vec::new())
            }
        };
        let contract = PolicyContract::read(&fields, hand).map_err(failed)?;
        let policy = Self { contract, network, notes };
        policy.check(hand).map_err(failed)?;
        Ok(Arc::new(policy))
    }

    /// Returns the contents of a policy's file and of the file that completes its contract, if there is one.
    ///
    /// # Errors
    /// [`PolicyError::File`] if a file cannot be read, or is not that of a policy.
    pub fn files(path: &Path) -> Result<(Vec<u8>, String), PolicyError> {
        if path == Path::new(CORRECTED) {
            return Ok((CARRIED.0.to_vec(), CARRIED.1.to_owned()));
        }
        let failed = |path: &Path, reason: &str| PolicyError::File { path: path.to_owned(), reason: one_line(reason) };
        match path.extension().and_then(OsStr::to_str) {
            Some("safetensors" | "onnx") => {}
            Some("pt" | "pth" | "pkl" | "pickle" | "zip" | "ckpt") => {
                return Err(failed(
                    path,
                    "a pickle can run any code and is not opened; export the policy as ONNX or safetensors, see docs/policies.md",
                ));
            }
            _ => return Err(failed(path, "a policy ends in .onnx or .safetensors")),
        }
        let beside = path.with_extension("toml");
        let text = match beside.exists() {
            true => input::read_text(&beside, LARGEST_CONTRACT).map_err(|e| failed(&beside, &e.to_string()))?,
            false => String::new(),
        };
        Ok((input::read(path, LARGEST_POLICY).map_err(|e| failed(path, &e.to_string()))?, text))
    }

    /// Returns the fields of a contract in a file of its own.
    fn fields(text: &str) -> Result<Fields, String> {
        let fields = Fields::of_toml(text)?;
        match PolicyContract::unknown(&fields) {
            Some(unknown) => Err(unknown),
            None => Ok(fields),
        }
    }

    /// Compares the network with the contract, and tries it on an observation of zeros.
    fn check(&self, hand: &Hand) -> Result<(), String> {
        let Self { contract, network, .. } = self;
        let (observed, joints) = (contract.observation_size(hand), contract.joint_names.len());
        if observed > LARGEST_OBSERVATION {
            return Err(format!(
                "observation_terms_history_length: the observation has {observed} numbers; at most {LARGEST_OBSERVATION} are possible"
            ));
        }
        let [inputs, outputs] = network.sizes();
        if let Some(inputs) = inputs.filter(|inputs| *inputs != observed) {
            return Err(format!(
                "observation_names: the observations have {observed} numbers; the network takes {inputs}"
            ));
        }
        let wrong =
            |outputs: usize| format!("joint_names: there are {joints} joints; the network gives {outputs} actions");
        if let Some(outputs) = outputs.filter(|outputs| *outputs != joints) {
            return Err(wrong(outputs));
        }
        let actions = network.run(&vec![0.0; observed], &mut network.first_state())?;
        if actions.len() != joints {
            return Err(wrong(actions.len()));
        }
        match unbelievable(&actions) {
            Some(action) => Err(format!(
                "the action for an observation of zeros is {action}; actions lie within {LARGEST_ACTION}, so the weights or the normaliser are wrong"
            )),
            None => Ok(()),
        }
    }

    /// Returns the contract.
    pub fn contract(&self) -> &PolicyContract {
        &self.contract
    }

    /// Returns whether the policy corrects the gait that suits an object, and so needs one.
    pub fn corrects(&self) -> bool {
        self.contract.action == ActionKind::Correction
    }

    /// Returns peculiarities of the file that are no errors, in sentences.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Returns the network in words.
    pub fn network_in_words(&self) -> String {
        self.network.in_words()
    }

    /// Returns the state before the first observation.
    pub fn first_state(&self) -> Vec<Vec<f32>> {
        self.network.first_state()
    }

    /// Returns the action for an observation, in the order of the contract's joints, and changes the state.
    ///
    /// # Errors
    /// If the network cannot be run, or an action is not finite or exceeds [`LARGEST_ACTION`].
    pub fn act(&self, observation: &[f32], state: &mut [Vec<f32>]) -> Result<Vec<f32>, String> {
        let actions = self.network.run(observation, state)?;
        match unbelievable(&actions) {
            Some(action) => Err(format!("the policy gave the action {action}; actions lie within {LARGEST_ACTION}")),
            None => Ok(actions),
        }
    }

    /// Returns the start of an episode: tilt of the palm, torque limit, place of the object and pose of the hand. All that the contract does
    /// not state is that of the gait that suits the object; if none does, the palm is level, and the object starts at the grasp. A policy that
    /// corrects a gait leaves it as it is.
    pub fn start(&self, suited: Option<&Gait>, hand: &Hand) -> Gait {
        let contract = &self.contract;
        let mut default: JointAngles = vec![0.0; hand.joints().len()];
        for (&j, angle) in contract.joint_order(hand).iter().zip(&contract.default_joint_pos) {
            if let Some(to) = default.get_mut(j) {
                *to = *angle;
            }
        }
        // Gaits are those of the right hand.
        let default = hand.mirrored(&hand.within_ranges(&default));
        let [x, y] = hand.grasp_centre(&[]).map_or([0.0; 2], |centre| [centre.coords().x, centre.coords().y]);
        let strongest = hand.joints().iter().map(|joint| joint.drive.torque_limit).fold(0.01, f64::max);
        let mut gait = suited.cloned().unwrap_or_else(|| Gait {
            description: String::new(),
            params: Default::default(),
            period_s: 1.0,
            torque_limit_nm: strongest,
            gravity: LEVEL,
            axis: TurnAxis::default(),
            start_xy_m: [x, hand.side().sign() * y],
            open_pose: default.clone(),
            table: Vec::new(),
            feedback: None,
        });
        if self.corrects() {
            return gait;
        }
        "a policy".clone_into(&mut gait.description);
        gait.params.clear();
        gait.table.clear();
        gait.feedback = None;
        gait.axis = contract.axis.unwrap_or(gait.axis);
        gait.torque_limit_nm = contract.torque_limit_nm.unwrap_or(gait.torque_limit_nm);
        if contract.start == PolicyStart::Default {
            gait.open_pose = default;
        }
        gait
    }
}

#[cfg(feature = "onnx")]
fn read_onnx(bytes: Vec<u8>, sidecar: Fields) -> Result<(Fields, Network, Vec<String>), String> {
    let (mut fields, network) = crate::onnx::OnnxNetwork::read(bytes)?;
    fields.complete(sidecar)?;
    let notes = network.notes();
    Ok((fields, Network::Onnx(Box::new(network)), notes))
}

#[cfg(not(feature = "onnx"))]
fn read_onnx(_: Vec<u8>, _: Fields) -> Result<(Fields, Network, Vec<String>), String> {
    Err("this program was built without ONNX; build it with `--features onnx`, or export the policy as safetensors, see docs/policies.md".to_owned())
}

/// Returns the first action that no sound policy gives.
fn unbelievable(actions: &[f32]) -> Option<f32> {
    actions.iter().copied().find(|action| !action.is_finite() || action.abs() > LARGEST_ACTION)
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
