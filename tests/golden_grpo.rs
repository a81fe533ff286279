//! The objective of GRPO against values worked out in double precision from the paper's equations.

use std::collections::BTreeSet;

use riglab_nn::grpo::{
    Objective, ObjectiveConfig, Policies, Scale, advantages, entropy, log_softmax_within, objective,
};
use riglab_nn::optim::Optimizer;
use riglab_nn::params::Weights;
use riglab_nn::tokenrig::{NextTokens, Sequences, TokenRig};
use riglab_tests::{Golden, golden, optimizer, sizes, started, tiny_tokenrig};
use tch::{Kind, Tensor};

fn numbers(t: &Tensor) -> Vec<f64> {
    Vec::<f64>::try_from(t.to_kind(Kind::Double).contiguous().view([-1])).unwrap()
}

#[test]
fn objectives_of_small_groups() {
    riglab_torch::init(riglab_torch::Settings { threads: 1 });
    for (_, golden) in golden("grpo", &["objective"]) {
        // By their tensors: a side file may tell of cases that are left out.
        let names: BTreeSet<&str> = golden.names("out.").filter_map(|name| Some(name.split_once('.')?.0)).collect();
        for name in names {
            case(&golden, name);
        }
        golden.done();
    }
}

fn case(golden: &Golden, name: &str) {
    let given = |key: &str| golden.get(&format!("in.{name}.{key}"));
    let number = |key: &str| golden.config("cases")[name][key].as_f64().unwrap();
    let mask = given("mask").to_kind(Kind::Bool);
    let valid = mask.view([-1]).nonzero().squeeze_dim(1);
    let tokens = |t: &Tensor| t.contiguous().view([-1]).index_select(0, &valid);
    let logits = given("logits").set_requires_grad(true);
    let allowed = golden.tensors.get(&format!("in.{name}.allowed")).map(|a| a.to_kind(Kind::Bool));
    let likely = log_softmax_within(&logits, allowed.as_ref(), 1.0);
    let now = tokens(&likely.gather(-1, &given("ids").unsqueeze(-1), false));
    let lengths: Vec<i64> = numbers(&mask.sum_dim_intlist(-1, false, Kind::Int64)).iter().map(|n| *n as i64).collect();
    let groups: Vec<usize> = numbers(&given("groups")).iter().map(|g| *g as usize).collect();
    let own = advantages(&numbers(&given("rewards")), &groups, Scale::Group);
    golden.check(&format!("out.{name}.adv"), &Tensor::from_slice(&own));
    let population = advantages(&numbers(&given("rewards")), &groups, Scale::Population);
    golden.check_if_there(&format!("out.{name}.adv_population"), &Tensor::from_slice(&population));
    let config = ObjectiveConfig { clip: number("eps"), beta: number("beta"), ..ObjectiveConfig::default() };
    let (old, reference) = (tokens(&given("old_logp")), tokens(&given("ref_logp")));
    let policies = Policies { now: &now, old: &old, reference: &reference };
    let Objective { loss, policy, per_sequence, ratio, k3, clip_fraction } =
        objective(&policies, &lengths, &groups, &own, &config);
    // What does not count is taken from the case.
    let whole = |key: &str, own: &Tensor| {
        let name = format!("out.{name}.{key}");
        let wanted = golden.get(&name);
        golden.check(&name, &wanted.masked_scatter(&mask, own));
    };
    whole("logp", &now.detach());
    whole("ratio", &ratio);
    whole("k3", &k3);
    let check = |key: &str, own: f64| golden.check(&format!("out.{name}.{key}"), &Tensor::from(own));
    golden.check(&format!("out.{name}.per_sequence"), &per_sequence);
    check("loss", loss.double_value(&[]));
    check("policy_loss", policy.double_value(&[]));
    check("clip_fraction", clip_fraction);
    check("kl", k3.mean(None::<Kind>).double_value(&[]));
    check("entropy", tokens(&entropy(&likely)).mean(None::<Kind>).double_value(&[]));
    check("ratio_mean", ratio.mean(None::<Kind>).double_value(&[]));
    check("ratio_min", ratio.min().double_value(&[]));
    check("ratio_max", ratio.max().double_value(&[]));
    let grads = Tensor::run_backward(&[loss], &[&logits], false, false);
    golden.check(&format!("grad.{name}.logits"), &grads[0]);
}

#[test]
fn two_updates_of_a_tiny_rig_decoder() {
    riglab_torch::init(riglab_torch::Settings { threads: 1 });
    let start = golden("skintokens", &["tokenrig_generate", "tokenrig_forward"]);
    for (_, golden) in golden("grpo", &["policy_step"]) {
        let weights = started(golden.config("start").as_str().unwrap(), &start);
        updates(&golden, weights, sizes(weights, &start));
        golden.done();
    }
}

/// Log-probabilities of what follows the prompt, of all sequences one after another, and how many each has.
fn scored(net: &TokenRig, w: &Weights, prefix: &Tensor, ids: &[Vec<i64>], prompt: usize) -> (Tensor, Vec<i64>) {
    let lengths: Vec<i64> = ids.iter().map(|s| s.len() as i64).collect();
    let flat = Tensor::from_slice(&ids.concat());
    let prefix = prefix.expand([ids.len() as i64, -1, -1], false);
    let hidden = net.forward(w, &prefix, &Sequences { ids: &flat, lengths: &lengths, told: None }, false);
    let targets: Vec<i64> = ids.iter().flat_map(|s| &s[1..]).copied().collect();
    let targets = Tensor::from_slice(&targets);
    let asked = NextTokens { hidden: &hidden, targets: &targets, bins: 256, spread: 0.0 };
    let likely = net.likelihood(w, &asked, None, 1.0).log;
    // The prompt is not scored.
    let skip = prompt as i64 - 1;
    let each = likely.split_with_sizes(lengths.iter().map(|n| n - 1).collect::<Vec<_>>(), 0);
    let each: Vec<Tensor> = each.iter().map(|own| own.narrow(0, skip, own.size()[0] - skip)).collect();
    (Tensor::cat(&each, 0), each.iter().map(|own| own.size()[0]).collect())
}

fn updates(golden: &Golden, weights: &Golden, sizes: &Golden) {
    let (net, params) = tiny_tokenrig(weights, sizes, Kind::Double);
    let number = |key: &str| golden.number(key);
    let config = optimizer(golden);
    let mut optimizer = Optimizer::new(&params, config);
    let w = params.weights();
    let of = golden.config("cond").as_i64().unwrap_or(0);
    let prefix = weights.get("in.cond").narrow(0, of, 1).to_kind(Kind::Double);
    assert_eq!(prefix.size()[1], number("prefix_vectors") as i64);
    let rewards = numbers(&golden.get("in.rewards"));
    let n = rewards.len();
    let ids: Vec<Vec<i64>> =
        (0..n).map(|s| Vec::<i64>::try_from(golden.get(&format!("in.ids.{s}"))).unwrap()).collect();
    let all = |key: &str| Tensor::cat(&(0..n).map(|s| golden.get(&format!("in.{key}.{s}"))).collect::<Vec<_>>(), 0);
    let (old, reference) = (all("old_logp"), all("ref_logp"));
    let told = |key: &str| golden.has(key).then(|| numbers(&golden.get(key)));
    let groups: Vec<usize> = told("in.groups").map_or(vec![0; n], |all| all.iter().map(|g| *g as usize).collect());
    let own = advantages(&rewards, &groups, Scale::Group);
    golden.check("out.adv", &Tensor::from_slice(&own));
    let c = ObjectiveConfig { clip: number("eps"), beta: number("beta"), ..ObjectiveConfig::default() };
    let reached: Vec<_> = params.ids().filter(|&id| params.name(id).starts_with("transformer.")).collect();
    let steps = golden.names("out.loss_").count();
    for step in 0..steps {
        let (now, lengths) = scored(&net, w, &prefix, &ids, number("prompt_tokens") as usize);
        let policies = Policies { now: &now, old: &old, reference: &reference };
        let loss = objective(&policies, &lengths, &groups, &own, &c).loss;
        golden.check(&format!("out.loss_{step}"), &loss);
        if step == 0 {
            for (s, own) in now.detach().split_with_sizes(&lengths, 0).iter().enumerate() {
                golden.check_if_there(&format!("out.logp.{s}"), own);
            }
        }
        let inputs: Vec<&Tensor> = reached.iter().map(|&id| &w[id]).collect();
        let found = Tensor::run_backward(&[loss], &inputs, false, false);
        if step == 0 {
            let norm = found.iter().map(|g| g.square().sum(Kind::Double).double_value(&[])).sum::<f64>().sqrt();
            golden.check_if_there("out.grad_norm", &Tensor::from(norm));
            for (&id, grad) in reached.iter().zip(&found) {
                golden.check_if_there(&format!("grad.{}", params.name(id).trim_start_matches("transformer.")), grad);
            }
        }
        let mut grads: Vec<Tensor> = w.tensors().iter().map(Tensor::zeros_like).collect();
        for (id, grad) in reached.iter().zip(found) {
            grads[id.index()] = grad;
        }
        optimizer.step(&params, grads, 1.0).unwrap();
    }
    for &id in &reached {
        let own = params.name(id).trim_start_matches("transformer.model.");
        golden.check_if_there(&format!("out.{}", own.trim_end_matches(".weight")), &w[id]);
    }
}
