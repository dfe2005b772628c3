"""Makes policies as mjlab exports them, and plays them in ONNX Runtime.

    oracle.py FOLDER STEPS HIDDEN

writes into FOLDER, for `mlp` (normaliser, three layers with ELU) and `gru` (normaliser, a GRU with h_in and h_out, a layer):
NAME.onnx, NAME.observations and NAME.actions (32-bit floats, one row per step). Needs the packages numpy, onnx and onnxruntime.
"""

import sys
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper, numpy_helper

JOINTS = [f"{finger}_{k}" for finger in ("thumb", "index", "middle", "ring") for k in range(4)]
TERMS = {"joint_pos": (16, 3), "joint_vel": (16, 0), "actions": (16, 0), "projected_gravity": (3, 0), "command": (3, 0)}
SIZE = sum(size * max(history, 1) for size, history in TERMS.values())


def csv(values):
    """Writes a list as mjlab's `list_to_csv_str` does: three decimals."""
    entry = lambda v: f"{v:.3f}" if isinstance(v, (int, float)) else ";".join(map(entry, v)) if isinstance(v, list) else str(v)
    return ",".join(map(entry, values))


def metadata():
    infinite = [float("-inf"), float("inf")]
    # The middle of the Allegro's ranges, for the joints in this order.
    default = [0.9, 0.5, 0.5, 0.6] + 3 * [0.0, 0.6, 0.7, 0.7]
    return {
        "run_path": "none",
        "joint_names": csv(JOINTS),
        "joint_stiffness": csv([3.0] * 16),
        "joint_damping": csv([0.1] * 16),
        "default_joint_pos": csv(default),
        "command_names": csv(["command"]),
        "observation_names": csv(list(TERMS)),
        "observation_terms_scale": csv([1.0, 0.2, 1.0, 1.0, 1.0]),
        "observation_terms_flatten_history_dim": csv([True] * 5),
        "observation_terms_history_length": csv([history for _, history in TERMS.values()]),
        "observation_terms_clip": csv([infinite, [-10.0, 10.0], infinite, infinite, infinite]),
        "action_scale": "0.3",
        # Not of mjlab: the rate, which its metadata lack.
        "control_hz": "25",
    }


def network(name, hidden, rng):
    tensors, nodes = [], []

    def tensor(label, array):
        tensors.append(numpy_helper.from_array(np.asarray(array), label))
        return label

    def weights(label, *shape):
        return tensor(label, (rng.standard_normal(shape) / np.sqrt(shape[-1])).astype(np.float32))

    mean = tensor("mean", rng.standard_normal((1, SIZE)).astype(np.float32) * np.float32(0.1))
    std = tensor("std", rng.uniform(0.5, 2.0, (1, SIZE)).astype(np.float32))
    nodes += [helper.make_node("Sub", ["obs", mean], ["centred"]), helper.make_node("Div", ["centred", std], ["x0"])]
    inputs = [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, SIZE])]
    outputs = [helper.make_tensor_value_info("actions", TensorProto.FLOAT, [1, 16])]
    if name == "mlp":
        widths = [SIZE, hidden, hidden, 16]
        for k, (before, after) in enumerate(zip(widths, widths[1:])):
            out = "actions" if after == 16 and k == 2 else f"y{k}"
            gemm = ["x" + str(k), weights(f"w{k}", after, before), weights(f"b{k}", after)]
            nodes.append(helper.make_node("Gemm", gemm, [out], transB=1))
            if k < 2:
                nodes.append(helper.make_node("Elu", [out], [f"x{k + 1}"]))
    else:
        nodes.append(helper.make_node("Unsqueeze", ["x0", tensor("first", np.array([0]))], ["sequence"]))
        gru = ["sequence", weights("w", 1, 3 * hidden, SIZE), weights("r", 1, 3 * hidden, hidden), weights("b", 1, 6 * hidden), "", "h_in"]
        nodes.append(helper.make_node("GRU", gru, ["", "h_out"], hidden_size=hidden, linear_before_reset=1))
        nodes.append(helper.make_node("Squeeze", ["h_out", "first"], ["last"]))
        nodes.append(helper.make_node("Gemm", ["last", weights("w0", 16, hidden), weights("b0", 16)], ["actions"], transB=1))
        inputs.append(helper.make_tensor_value_info("h_in", TensorProto.FLOAT, [1, 1, hidden]))
        outputs.append(helper.make_tensor_value_info("h_out", TensorProto.FLOAT, [1, 1, hidden]))
    model = helper.make_model(helper.make_graph(nodes, name, inputs, outputs, tensors), opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 9
    helper.set_model_props(model, metadata())
    onnx.checker.check_model(model)
    return model


def main():
    folder, steps, hidden = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    for name in ("mlp", "gru"):
        rng = np.random.default_rng(7)
        model = network(name, hidden, rng)
        onnx.save(model, folder / f"{name}.onnx")
        session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
        observations = rng.standard_normal((steps, SIZE)).astype(np.float32)
        state = {"h_in": np.zeros((1, 1, hidden), np.float32)} if name == "gru" else {}
        actions = []
        for observation in observations:
            action, *rest = session.run(None, {"obs": observation[None], **state})
            actions.append(action[0])
            if state:
                state["h_in"] = rest[0]
        observations.tofile(folder / f"{name}.observations")
        np.asarray(actions, np.float32).tofile(folder / f"{name}.actions")


main()
