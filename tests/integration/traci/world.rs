//! A small world with many kinds of objects: a crossing with traffic lights and sidewalks, a
//! railway with a signal, detectors, a parking area, a bus stop, a taxi, and persons who walk, wait
//! and ride.

use std::{path::PathBuf, process::Command};

use iwol_sumo::sumo::{
    Client, find_program,
    process::{Options, Process},
};

const NODES: &str = r#"<nodes><node id="w" x="10.99732" y="48"/><node id="c" x="11" y="48" type="traffic_light"/><node id="e" x="11.00268" y="48"/><node id="s" x="11" y="47.9982"/><node id="n" x="11" y="48.0018"/><node id="ra" x="10.99" y="48.003"/><node id="rb" x="11" y="48.003" type="rail_signal"/><node id="rc" x="11.01" y="48.003"/></nodes>
"#;

const EDGES: &str = r#"<edges>
<edge id="wc" from="w" to="c" numLanes="3" speed="15" name="West Street"/>
<edge id="ce" from="c" to="e" numLanes="3" speed="15"/>
<edge id="sc" from="s" to="c" numLanes="2" speed="13"/>
<edge id="cn" from="c" to="n" numLanes="2" speed="13"/>
<edge id="ec" from="e" to="c" numLanes="2" speed="15"/>
<edge id="cw" from="c" to="w" numLanes="2" speed="15"/>
<edge id="rab" from="ra" to="rb" allow="rail"/>
<edge id="rbc" from="rb" to="rc" allow="rail"/></edges>
"#;

const ADDITIONAL: &str = r#"<additional>
 <vType id="car" accel="2.5" sigma="0.3" personCapacity="4"/>
 <vType id="taxi" vClass="taxi" color="1,1,0"><param key="has.taxi.device" value="true"/></vType>
 <vType id="train" vClass="rail"/>
 <route id="rail" edges="rab rbc"/>
 <route id="through" edges="wc ce"/>
 <inductionLoop id="loop" lane="wc_1" pos="100" freq="60" file="NUL"/>
 <inductionLoop id="loop2" lane="wc_2" pos="140" freq="60" file="NUL"/>
 <laneAreaDetector id="area" lane="wc_2" pos="120" endPos="190" freq="60" file="NUL"/>
 <parkingArea id="park" lane="ce_1" startPos="40" endPos="80" roadsideCapacity="4" name="By the Way"/>
 <busStop id="stop" lane="wc_1" startPos="60" endPos="80" name="Halt"/>
 <poi id="poi" x="10" y="20" color="0,128,255,200" type="shop" layer="3" angle="30" width="2" height="4"/>
 <poly id="poly" shape="0,0 10,0 10,10" color="255,0,0" fill="1" type="building" layer="1" lineWidth="2.5"/>
 <railSignalConstraints id="rb"><predecessor tripId="slow" tl="rb" foes="fast" limit="2"/></railSignalConstraints>
</additional>
"#;

/// Objects of the kinds that [`ADDITIONAL`] lacks. SUMO 1.15 cannot load a state of some of them.
const MORE: &str = r#"<additional>
 <route id="back" edges="ec cw"/>
 <chargingStation id="charger" lane="cw_1" startPos="20" endPos="50" power="22000" efficiency="0.95" name="Plug"/>
 <tractionSubstation id="power" voltage="600" currentLimit="400"/>
 <overheadWireSegment id="wire" lane="rab_0" startPos="10" endPos="100" substationId="power"/>
 <entryExitDetector id="gate" freq="20" file="NUL"><detEntry lane="wc_1" pos="20"/><detEntry lane="wc_2" pos="25"/><detExit lane="wc_1" pos="150"/><detExit lane="wc_2" pos="155"/></entryExitDetector>
 <edgeData id="mean" freq="100" file="NUL"/>
 <routeProbe id="probe" edge="rab" freq="20" file="NUL"/>
 <calibrator id="calibrator" edge="ec" pos="20" vTypes="car" routeProbe="probe" output="NUL"><flow begin="0" end="9000" type="car" route="back" vehsPerHour="700" speed="12" departLane="free"/></calibrator>
 <rerouter id="rerouter" edges="cn" probability="0"><interval begin="500" end="600"><destProbReroute id="ce"/></interval></rerouter>
 <variableSpeedSign id="sign" lanes="cw_0 cw_1"><step time="0" speed="10"/></variableSpeedSign>
</additional>
"#;

const ROUTES: &str = r#"<routes>
 <vehicle id="parker" type="car" route="through" depart="0" departLane="2" departSpeed="10"><stop parkingArea="park" duration="500"/></vehicle>
  <vehicle id="slow" type="train" route="rail" depart="0"><param key="tripId" value="slow"/></vehicle>
 <person id="walker" depart="0"><walk edges="wc ce" arrivalPos="150"/></person>
 <person id="waiter" depart="0" departPos="50"><walk from="wc" busStop="stop"/><ride to="ce" lines="9"/></person>
 <vehicle id="bus" type="car" route="through" depart="1" line="7" departLane="1"><stop busStop="stop" duration="200" until="300"/></vehicle>
 <vehicle id="left" type="car" route="through" depart="2" departLane="2"/>
 <person id="sleeper" depart="3"><walk from="ce" to="ce" arrivalPos="10"/><stop lane="ce_0" duration="100" endPos="10" actType="rest"/></person>
 <flow id="many" type="car" begin="3" end="100" period="3" from="wc" to="ce" departLane="random" via="ce"/>
 <flow id="north" type="car" begin="3" end="100" period="7" from="sc" to="cn" departLane="random"/>
 <flow id="west" type="car" begin="3" end="100" period="9" from="ec" to="cw" departLane="random"/>
 <vehicle id="cab" type="taxi" depart="4" departLane="1"><route edges="sc cn"/><stop lane="sc_1" endPos="60" duration="1000"/></vehicle>
 <person id="customer" depart="5" departPos="100"><ride from="sc" to="cn" lines="taxi"/></person>
 <person id="guest.a" depart="5" departPos="90"><ride from="sc" to="cn" lines="taxi" group="two"/></person>
 <person id="guest.b" depart="5" departPos="90"><ride from="sc" to="cn" lines="taxi" group="two"/></person>
 <vehicle id="fast" type="train" route="rail" depart="20"><param key="tripId" value="fast"/></vehicle>
</routes>
"#;

/// The world's files, in a temporary folder of their own.
pub struct World {
    folder: tempfile::TempDir,
    additional: &'static str,
}

impl World {
    pub fn new() -> Self {
        Self::with("n.add.xml")
    }

    /// Returns the world with objects of all kinds.
    pub fn with_all_kinds() -> Self {
        Self::with("n.add.xml,n.more.xml")
    }

    fn with(additional: &'static str) -> Self {
        let world = World { folder: tempfile::tempdir().unwrap(), additional };
        let files =
            [("nod", NODES), ("edg", EDGES), ("add", ADDITIONAL), ("more", MORE), ("rou", ROUTES)];
        for (kind, text) in files {
            std::fs::write(world.file(&format!("n.{kind}.xml")), text).unwrap();
        }
        let netconvert = find_program("netconvert")
            .unwrap_or_else(|e| panic!("{e}; hint: {}", e.hint().unwrap_or_default()));
        let output = Command::new(netconvert)
            .args(["-n", "n.nod.xml", "-e", "n.edg.xml", "-o", "n.net.xml", "--proj.utm"])
            .args(["--sidewalks.guess", "--crossings.guess", "--tls.default-type", "actuated"])
            .current_dir(world.folder.path())
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        world
    }

    pub fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Returns SUMO's command line without the program.
    pub fn arguments(&self) -> Vec<String> {
        let files = [("-n", "n.net.xml"), ("-a", self.additional), ("-r", "n.rou.xml")];
        let path = |name: &str| self.file(name).to_str().unwrap().to_owned();
        let files = files.map(|(option, names)| {
            let paths: Vec<String> = names.split(',').map(path).collect();
            [option.to_owned(), paths.join(",")]
        });
        let words = "--seed 4 --xml-validation never --no-step-log --no-warnings --device.taxi.dispatch-algorithm traci";
        files.into_iter().flatten().chain(words.split(' ').map(String::from)).collect()
    }

    pub fn start(&self) -> (Process, Client) {
        let arguments = self.arguments().into_iter().map(Into::into).collect();
        let (process, client, _) =
            Process::start(&Options { arguments, ..Options::default() }).unwrap();
        (process, client)
    }
}
