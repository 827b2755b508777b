//! Tests of what a simulation reports, against SUMO's own answers. They fail if SUMO is missing.

use super::*;

#[test]
fn states_of_traffic_lights_are_those_that_sumo_says() {
    for worlds in [1, 3] {
        let config = SimulationConfig {
            net: "sumo_nets/signals/signals.net.xml".into(),
            traffic_lights: vec!["centre".into()],
            worlds,
            ..SimulationConfig::crossing(0)
        };
        let mut simulation = TraciSimulation::start(config).unwrap();
        let start =
            |world, phase| Command::StartPhase { world, traffic_light: 0, phase, remaining: 0.7 };
        for step in 0..450_u32 {
            // The programs of the worlds begin at different times.
            let commands = match step {
                40 => vec![start(worlds - 1, 4)],
                130 => vec![start(0, 2)],
                _ => Vec::new(),
            };
            simulation.step(&commands).unwrap();
            for world in 0..worlds as usize {
                let name = simulation.fleet.traffic_lights[world].clone();
                let found = simulation.snapshot().traffic_lights[world].clone();
                let mut lights = simulation.client.traffic_light();
                assert_eq!(found.state, lights.get_red_yellow_green_state(&name).unwrap());
                assert_eq!(found.phase, lights.get_phase(&name).unwrap());
                assert_eq!(found.next_switch, lights.get_next_switch(&name).unwrap());
            }
        }
        assert_eq!(simulation.meter().exchanges, 450, "one exchange per step");
        assert!(simulation.step(&[start(worlds, 0)]).unwrap_err().to_string().contains("world"));
    }
}
