//! Policies that were trained here, as files that [`crate::Policy::read`] reads.

use mvt_robot::hand::Side;
use safetensors::tensor::{Dtype, TensorView};
use toml::{Table, Value};

use crate::contract::{ActionKind, PolicyContract, PolicyStart};
use crate::error::PolicyError;

/// Linear layer of a policy: a matrix by rows, one for each output, with an addend for each.
#[derive(Debug, Clone, PartialEq)]
pub struct PolicyLayer {
    /// Number of inputs.
    pub inputs: usize,
    /// The matrix, row by row.
    pub weight: Vec<f32>,
    /// The addends.
    pub bias: Vec<f32>,
}

/// Network of a policy: a normaliser and linear layers with ELU between them.
#[derive(Debug, Clone, PartialEq)]
pub struct MadePolicy {
    /// Mean of each observed number.
    pub mean: Vec<f32>,
    /// Standard deviation of each observed number.
    pub std: Vec<f32>,
    /// Greatest absolute value of a normalised number.
    pub clip: f32,
    /// The layers, that of the actions last.
    pub layers: Vec<PolicyLayer>,
}

impl MadePolicy {
    /// Returns the contents of the safetensors file and of the TOML file beside it.
    ///
    /// # Errors
    /// [`PolicyError::Made`] if a matrix has not as many numbers as its shape.
    pub fn files(&self, contract: &PolicyContract) -> Result<(Vec<u8>, String), PolicyError> {
        let bytes = |numbers: &[f32]| -> Vec<u8> { numbers.iter().flat_map(|number| number.to_le_bytes()).collect() };
        let mut tensors = vec![
            ("normaliser.mean".to_owned(), vec![self.mean.len()], bytes(&self.mean)),
            ("normaliser.std".to_owned(), vec![self.std.len()], bytes(&self.std)),
        ];
        for (k, PolicyLayer { inputs, weight, bias }) in self.layers.iter().enumerate() {
            tensors.push((format!("layers.{k}.weight"), vec![bias.len(), *inputs], bytes(weight)));
            tensors.push((format!("layers.{k}.bias"), vec![bias.len()], bytes(bias)));
        }
        let failed = |e: safetensors::SafeTensorError| PolicyError::Made(e.to_string());
        let views = tensors.iter().map(|(name, shape, bytes)| {
            Ok((name.as_str(), TensorView::new(Dtype::F32, shape.clone(), bytes).map_err(failed)?))
        });
        let views: Vec<(&str, TensorView<'_>)> = views.collect::<Result<_, PolicyError>>()?;
        let mut fields = fields(contract);
        fields.insert("activation".to_owned(), "elu".into());
        fields.insert("normaliser_clip".to_owned(), f64::from(self.clip).into());
        Ok((safetensors::serialize(views, None).map_err(failed)?, fields.to_string()))
    }
}

/// Returns the fields of a contract.
fn fields(contract: &PolicyContract) -> Table {
    let numbers = |numbers: &[f64]| Value::Array(numbers.iter().map(|number| Value::Float(*number)).collect());
    let observed = &contract.observation;
    let mut fields = Table::new();
    let mut add = |name: &str, value: Value| fields.insert(name.to_owned(), value);
    add("joint_names", contract.joint_names.clone().into());
    add("joint_stiffness", numbers(&contract.joint_stiffness));
    add("joint_damping", numbers(&contract.joint_damping));
    add("default_joint_pos", numbers(&contract.default_joint_pos));
    add("action_scale", numbers(&contract.action_scale));
    add("observation_names", observed.iter().map(|observed| observed.term.name()).collect::<Vec<_>>().into());
    add("observation_terms_scale", Value::Array(observed.iter().map(|observed| numbers(&observed.scale)).collect()));
    add("observation_terms_clip", Value::Array(observed.iter().map(|observed| numbers(&observed.clip)).collect()));
    let history = observed.iter().map(|observed| Value::Float(observed.history as f64));
    add("observation_terms_history_length", Value::Array(history.collect()));
    add("history_order", if contract.newest_first { "newest_first" } else { "oldest_first" }.into());
    add("control_hz", i64::from(contract.control_hz).into());
    let action = match contract.action {
        ActionKind::Absolute => "absolute",
        ActionKind::Incremental => "incremental",
        ActionKind::Correction => "correction",
    };
    add("action", action.into());
    if contract.action_clip.is_finite() {
        add("action_clip", contract.action_clip.into());
    }
    let start = match contract.start {
        PolicyStart::Default => "default",
        PolicyStart::Suited => "suited",
    };
    add("start", start.into());
    if let Some(hand) = &contract.hand {
        add("hand", hand.clone().into());
    }
    if let Some(side) = contract.side {
        add("side", if side == Side::Left { "left" } else { "right" }.into());
    }
    if let Some(axis) = contract.axis {
        add("axis", axis.to_string().into());
    }
    if let Some(limit_nm) = contract.torque_limit_nm {
        add("torque_limit_nm", limit_nm.into());
    }
    fields
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a failed assumption in a test is a failed test")]

    use mvt_robot::hand::Hand;

    use super::*;
    use crate::contract::ObservedTerm;
    use crate::fields::Fields;
    use crate::term::ObservationTerm;

    #[test]
    fn a_contract_that_is_written_is_read_again() {
        let hand = Hand::allegro(Side::Left);
        let turning = PolicyContract::turning(&hand, 25);
        let [sighted, correcting] = [PolicyContract::sighted(&hand, 25), PolicyContract::correcting(&hand, 25)];
        let mut other = turning.clone();
        other.joint_names.reverse();
        other.default_joint_pos.reverse();
        other.joint_stiffness[3] = 1.0 / 3.0;
        (other.action, other.action_clip, other.newest_first) = (ActionKind::Absolute, f64::INFINITY, false);
        (other.side, other.axis, other.start) = (Some(Side::Left), Some("-y".parse().unwrap()), PolicyStart::Default);
        (other.hand, other.torque_limit_nm) = (None, Some(0.4));
        other.observation.push(ObservedTerm {
            term: ObservationTerm::ProjectedGravity,
            clip: [f64::NEG_INFINITY, f64::INFINITY],
            scale: vec![1.0, 2.0, 3.0],
            history: 1,
        });
        for contract in [turning, sighted, correcting, other] {
            let text = fields(&contract).to_string();
            assert_eq!(PolicyContract::read(&Fields::of_toml(&text).unwrap(), &hand), Ok(contract), "{text}");
        }
    }
}
