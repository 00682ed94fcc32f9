//! A test for an integrator to copy: a body of one's own, a fault of one's own, measured as at a station.

use datum::capture::{Devices, Plan, record};
use datum::measure::{Measurer, Verdict, measure, teach};
use datum::sim::{self, Body, Cover, Cue, Deviation, Fault, Paint, Scene, Script, Setup, Station, When};
use std::{path::Path, sync::Arc};

#[test]
fn a_vehicle_whose_wheel_arch_is_covered_is_not_measured() -> Result<(), Box<dyn std::error::Error>> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("integrator");
    let setup = Arc::new(Setup::new(0.25, 8)); // a small image, so that it is quick
    let (body, paint) = (Body::random(6), Paint::named("white").expect("listed"));
    let capture = |stands: Deviation, script: Script, name: &str| {
        let station = Station::with_vehicle(Arc::clone(&setup), 1, (body.clone(), paint, stands), script);
        let (mut camera, mut projector, mut bars) = (station.camera(), station.projector(), station.bars());
        let mut devices = Devices { camera: &mut camera, projector: &mut projector, bars: &mut bars };
        record(&mut devices, &Plan::default(), &folder.join(name))
    };
    // teach, as datum teach does
    let scene = Scene::new(body.clone(), paint, &Deviation::default());
    let features = sim::features(&scene, &setup).expect("all in view");
    let good = capture(Deviation::default(), Script::default(), "good")?;
    let mut taught = teach(&good, &sim::calibration(&setup), &features, "own")?;
    for (feature, template) in taught.model.features.iter().zip(&taught.templates) {
        std::fs::write(folder.join(feature.template.as_ref().expect("taught")), template.to_bytes())?;
    }
    taught.model.file = folder.join("own.toml");
    let measurer = Measurer::new(sim::calibration(&setup), taught.model)?;
    // another pose: measured as it is, not measured with a cover over its wheel arch
    let stands = Deviation { along_mm: -15.0, yaw_deg: 2.0, ..Deviation::default() };
    let calm = capture(stands, Script::default(), "calm")?;
    assert_eq!(measure(&measurer, &calm, &mut |_| {})?.0.verdict, Verdict::Ok);
    let [x, _, z] = body.features().last().expect("it has some").at; // the top of its arch
    let cover = Fault::Covered(Cover { centre: [x, z - 20.0], half: [250.0, 60.0] });
    let covered = capture(stands, Script(vec![Cue { when: When::Always, fault: cover }]), "covered")?;
    let m = measure(&measurer, &covered, &mut |_| {})?.0;
    assert_eq!(m.verdict, Verdict::NotMeasurable, "{}", m.detail);
    Ok(())
}
