use std::collections::BTreeMap; use std::path::Path; use std::time::Instant;
use perception::engine::*; use perception::network::*;
fn main() {
    let names: Vec<String> = std::env::args().skip(1).collect();
    for name in names { let (name, c) = name.split_once(':').map(|(a,b)|(a.to_owned(), b.parse().unwrap())).unwrap_or((name, 0usize));
        let mut arch = Architecture::preset(&name).unwrap(); if c>0 { if let Architecture::Vit(v) = &mut arch { v.channels = c; } }
        let mut s = 1u32;
        let tensors: BTreeMap<_, _> = arch.tensors().into_iter().map(|(n, shape)| { let count = shape.iter().product::<usize>(); let fan = (count / shape[0]).max(1) as f32; let values = (0..count).map(|_| { s ^= s << 13; s ^= s >> 17; s ^= s << 5; ((s >> 8) as f32 / 8388608.0 - 1.0) / fan.sqrt() }).collect(); (n, Tensor { shape, values }) }).collect();
        let w = Weights::new(arch.clone(), Provenance::default(), tensors, Path::new("r")).unwrap();
        let (h, wd) = if c > 0 { (224, 224) } else { (320, 240) };
        let img = image::RgbImage::from_fn(wd, h, |x, y| image::Rgb([(x * 7 % 256) as u8, (y * 5 % 256) as u8, ((x + y) % 256) as u8]));
        println!("{name} {:?}", arch.cost([h as usize, wd as usize]));
        let mut reference: Option<Prediction> = None;
        for set in Instructions::available().collect::<Vec<_>>().into_iter().rev().filter(|s| std::env::var("SET").map_or(true, |v| v == s.name())) {
            let t = Instant::now(); let e = Engine::new(&w, set); let pack = t.elapsed().as_secs_f64();
            let mut p = Prediction::default(); e.infer(&img, &mut p).unwrap();
            let mut best = f64::MAX; let t0 = Instant::now(); let mut n = 0; while n < 3 || (t0.elapsed().as_secs_f64() < 2.0 && n < 400) { let t = Instant::now(); e.infer(&img, &mut p).unwrap(); best = best.min(t.elapsed().as_secs_f64()); n += 1; }
            let d = reference.as_ref().map(|r| (&r.contact_logit - &p.contact_logit).iter().fold(0f32, |m, x| m.max(x.abs()))).unwrap_or(0.0);
            let rms = (p.contact_logit.iter().map(|x| x * x).sum::<f32>() / p.contact_logit.len() as f32).sqrt();
            println!("  {}: pack {:.0} ms, {:.2} ms/image (best of {n}), max dev {d:.2e} of rms {rms:.2e}", set.name(), pack * 1e3, best * 1e3);
            if reference.is_none() { reference = Some(p.clone()); }
        }
    }
}
