#include "nmp/report.h"

#include <doctest/doctest.h>

#include <cmath>

#include "base/check.h"
#include "nmp/evaluate.h"
#include "nmp/plot.h"

namespace nmp {
namespace {

bool contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

std::size_t count(const std::string& text, const std::string& part) {
  std::size_t n = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) ++n;
  return n;
}

// Errors that grow to `end` over 500 frames, for two trajectories.
void add_method(Evaluation& evaluation, const std::string& name, double end) {
  MethodResult& method = evaluation.methods[name];
  for (const Index frame : {Index{100}, Index{500}}) {
    HorizonError& error = method.horizons[frame];
    const double size = end * static_cast<double>(frame) / 500;
    error.each = {0.9 * size, 1.1 * size};
    error.rmse = mean_std(error.each);
    error.relative = {size / 0.5, 0};
  }
  for (Index t = 0; t <= 500; ++t)
    method.curve.push_back({end * static_cast<double>(t) / 500, 0.1 * end});
}

Evaluation evaluation(double neural, double zeroed) {
  Evaluation e;
  e.scene = "cube";
  e.model = "model.safetensors";
  e.split = "val";
  e.n_trajectories = 2;
  e.frames = 500;
  e.force_error = 0.0123;
  add_method(e, "neural", neural);
  add_method(e, "residual_zeroed", zeroed);
  add_method(e, "staggered_physics", 1e-4);
  add_method(e, "rest", 0.5);
  return e;
}

// Errors of the modules along two trajectories.
ModuleErrors modules() {
  ModuleErrors m;
  m.stress = {0.0123, 2.5, 4e-5};
  m.windows = {{1, {0.0345, 1e-3, 0.0333}}, {20, {0.0067, 4e-3, std::nullopt}}};
  for (const char* name : {"val/000.safetensors", "val/<b>.safetensors"}) {
    ModuleErrors::Curves c;
    c.trajectory = name;
    c.frame = {0, 10, 20};
    c.touching = {0, 0.25, 0.5};
    c.stress = {std::nan(""), 0.1, 0.2};
    c.stress_reference = {std::nan(""), 1e-4, 1e-4};
    c.windows = {{{0.1, 0.1, 0.1}, {0.1, 0.1, 0.1}}, {{0.01, 0.01, std::nan("")}, {}}};
    m.trajectories.push_back(c);
  }
  return m;
}

// Two frames of a tet that is squeezed a little.
Playback playback(const std::string& name) {
  Playback p;
  p.trajectory = name;
  p.h = 5e-4;
  p.rmse = {0, 1e-3};
  p.touching = {0, 0.5};
  StateMeasures state;
  state.kinetic = 12;
  state.total = 80;
  p.truth = p.prediction = {state, state};
  p.truth[1].det_min = 0.8765;
  p.truth[1].total = 66;
  p.track.name = name;
  for (const char* label : {"recorded", "predicted"}) {
    PlayerMotion motion;
    motion.label = label;
    motion.h = p.h;
    for (Index t = 0; t < 2; ++t) {
      PlayerFrame frame;
      frame.t = t;
      frame.x = Matrix<double>::Identity(4, 3) * (1 - 0.1 * static_cast<double>(t));
      frame.det = frame.speed = Matrix<double>::Ones(4, 1);
      motion.frames.push_back(frame);
    }
    p.track.motions.push_back(motion);
  }
  return p;
}

PlayerBody tet() {
  fem::Tets tets(1, 4);
  tets << 0, 1, 2, 3;
  PlayerBody body;
  body.surface = fem::extract_surface(tets);
  return body;
}

const char* const kMetrics =
    R"({"event":"step","stage":"constitutive","iteration":0,"iterations":2,"loss":1.5,"lr":0.003,"grad_norm":1,"seconds":0.1}
{"event":"step","stage":"constitutive","iteration":1,"iterations":2,"loss":0.5,"lr":0.0,"grad_norm":1,"seconds":0.2}
{"event":"stage","stage":"constitutive","pairing":"neural law, semi-implicit Euler","iterations":2,"planned":3,"rmse_before":0.4,"rmse_after":0.001,"kept":2,"rmse_kept":0.001,"change":0.83,"change_end":0.83,"seconds":41.2}
{"event":"fit","alpha":0.001,"b":[0,0,-9.8],"residual":0.02}
)";

std::string report(const Evaluation& e, const std::string& metrics = "") {
  ReportInput input;
  input.title = "a <b>title</b>";
  input.evaluations = {to_json(e)};
  input.metrics = metrics;
  input.scene_toml = "name = \"cube\" # </pre><script>";
  return make_report(input);
}

// Message of the InputError that a report ends with; empty if it does not.
std::string refusal(const ReportInput& input) {
  try {
    make_report(input);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

TEST_SUITE("nmp/report") {
  TEST_CASE("shows errors, curves, training and settings of what it is given") {
    const std::string html = report(evaluation(6e-4, 9e-4), kMetrics);
    CHECK(contains(html, "neural simulator"));
    CHECK(contains(html, "frame 500"));
    CHECK(contains(html, "0.600 mm"));
    CHECK(contains(html, "6.00 ± 0.85 × 10⁻⁴"));  // 0.9 and 1.1 times 6e-4
    CHECK(contains(html, "0.159"));               // the paper's NMP at frame 500
    CHECK(contains(html, "1.23 %"));              // of the forces
    CHECK(contains(html, "2<small>of 3</small>"));
    CHECK(contains(html, "1/α = 1000 kg/m³"));
    CHECK(count(html, "<figure") == 3);
  }

  TEST_CASE("shows the modules' errors with what true modules leave") {
    Evaluation e = evaluation(6e-4, 9e-4);
    CHECK_FALSE(contains(report(e), "The modules by themselves"));
    e.modules = modules();
    const std::string html = report(e);
    CHECK(contains(html, "The modules by themselves"));
    CHECK(contains(html, "change of velocity over 20 frames"));
    CHECK(contains(html, "3.33 %"));
    CHECK(contains(html, "2.50 N"));
    CHECK(count(html, "error of the stress net&#39;s forces") +
              count(html, "error of the stress net's forces") >=
          2);
    CHECK_FALSE(contains(html, "val/<b>"));
    CHECK_FALSE(contains(html, "nan"));
    e.modules.trajectories.push_back(e.modules.trajectories[0]);
    CHECK(contains(report(e), "<summary>1 more"));
  }

  TEST_CASE("shows det F, energies and the player of what was played back") {
    ReportInput input;
    input.evaluations = {to_json(evaluation(6e-4, 9e-4))};
    const std::string without = make_report(input);
    input.playbacks = {playback("val/000.safetensors"), playback("</script><img>")};
    std::string html = make_report(input);
    CHECK(contains(html, "Volume and energy"));
    CHECK(contains(html, "0.876"));
    CHECK(contains(html, "14.0 J"));
    CHECK_FALSE(contains(html, "</script><img>"));
    CHECK_FALSE(contains(html, "data-player>"));
    CHECK_FALSE(contains(html, "webgl2"));

    input.player.bodies = {tet()};
    input.player.tracks = {input.playbacks[0].track, input.playbacks[1].track};
    input.player.tracks[1].motions[1].diverged = true;
    input.player.bodies[0].stress_law = "<i>law";
    html = make_report(input);
    CHECK(count(html, "data-player>") == 1);
    CHECK(contains(html, "getContext('webgl2'"));
    CHECK(contains(html, "Every one of the 1 frames is stored"));
    CHECK(contains(html, "this law has: &lt;i&gt;law"));
    CHECK(contains(html, "predicted of &lt;/script&gt;&lt;img&gt; diverged"));
    CHECK_FALSE(contains(html, "</script><img>"));
    for (const char* from_outside : {"src=", "href=", "url(", "@import", "fetch("})
      CHECK_FALSE(contains(html, from_outside));

    Playback& diverged = input.playbacks[1];
    diverged.law_known = false;
    diverged.prediction.clear();
    diverged.end = RolloutEnd();
    diverged.end.diverged = true;
    diverged.end.reason = "after frame 0: <b>bang</b>";
    html = make_report(input);
    CHECK(contains(html, "after frame 0: &lt;b&gt;bang"));
    CHECK(contains(html, "the law of the data is not known"));
    CHECK_FALSE(contains(html, "nan"));
  }

  TEST_CASE("opens without a network and lets no text become markup") {
    const std::string html = report(evaluation(6e-4, 9e-4), kMetrics);
    CHECK(contains(html, "default-src 'none'"));
    for (const char* from_outside : {"src=", "href=", "url(", "@import", "fetch("})
      CHECK_FALSE(contains(html, from_outside));
    CHECK_FALSE(contains(html, "<b>title</b>"));
    CHECK(contains(html, "a &lt;b&gt;title"));
    CHECK_FALSE(contains(html, "</pre><script>"));

    Evaluation hostile = evaluation(6e-4, 9e-4);
    add_method(hostile, "</script><img onerror=x>", 1e-3);
    CHECK_FALSE(contains(report(hostile), "</script><img"));
  }

  TEST_CASE("says when the residual net does not lower the error") {
    CHECK(contains(report(evaluation(6e-4, 6.1e-4)), "Identified, not learned."));
    CHECK(contains(report(evaluation(6e-4, 3e-4)), "Identified, not learned."));
    CHECK_FALSE(contains(report(evaluation(6e-4, 9e-4)), "Identified, not learned."));
    CHECK(contains(report(evaluation(6e-4, 9e-4)), "The residual net matters"));
  }

  TEST_CASE("says when rollouts diverged or are no better than standing still") {
    Evaluation e = evaluation(0.5, 0.5);
    e.methods["neural"].diverged = 1;
    e.methods["neural"].reasons = {"val/000: step 3"};
    const std::string html = report(e);
    CHECK(contains(html, "1 of 2 rollouts diverged"));
    CHECK(contains(html, "val/000: step 3"));
    CHECK(contains(html, "No better than standing still"));
  }

  TEST_CASE("copes with errors that are zero or not finite, and with no neural row") {
    Evaluation e = evaluation(0, 0);
    e.methods["rest"].curve[10].mean = std::nan("");
    e.methods["rest"].horizons[100].rmse.mean = std::nan("");
    CHECK_FALSE(contains(report(e), "nan"));
    e.methods.erase("neural");
    CHECK_FALSE(contains(report(e), "neural simulator</b>"));
  }

  TEST_CASE("shows several evaluations, each with its model's name") {
    ReportInput input;
    input.evaluations = {to_json(evaluation(6e-4, 9e-4)), to_json(evaluation(1e-3, 9e-4))};
    const std::string html = make_report(input);
    CHECK(count(html, "2 validation trajectories: model.safetensors") == 2);
  }

  TEST_CASE("refuses parts that are not what their command writes, saying which") {
    ReportInput input;
    for (const char* bad : {"", "{", "[]", "{}", "{\"scene\": 3}"}) {
      CAPTURE(bad);
      input.evaluations = {to_json(evaluation(6e-4, 9e-4)), bad};
      CHECK(contains(refusal(input), "evaluation 2"));
    }
    Evaluation short_curve = evaluation(6e-4, 9e-4);
    short_curve.methods["rest"].curve.pop_back();
    input.evaluations = {to_json(short_curve)};
    CHECK(contains(refusal(input), "the curves of rest have 500"));
    Evaluation bad_modules = evaluation(6e-4, 9e-4);
    bad_modules.modules = modules();
    bad_modules.modules.trajectories[1].stress.pop_back();
    input.evaluations = {to_json(bad_modules)};
    CHECK(contains(refusal(input), "evaluation 1: a module's curve has 2 and 3 points"));
    bad_modules.modules = modules();
    bad_modules.modules.trajectories[1].touching.clear();
    input.evaluations = {to_json(bad_modules)};
    CHECK(contains(refusal(input), "3 frames and 0 parts"));

    // Counts and frames: no fractions, no negative ones that fit an empty curve, no words.
    const std::string good = to_json(evaluation(6e-4, 9e-4));
    const auto changed = [&](const std::string& from, const std::string& to) {
      std::string text = good;
      const std::size_t at = text.find(from);
      REQUIRE(at != std::string::npos);
      input.evaluations = {text.replace(at, from.size(), to)};
      return refusal(input);
    };
    for (const char* bad : {"-1", "500.5", "1e300", "true", "null", "\"500\"", "1000000001"}) {
      CAPTURE(bad);
      CHECK(contains(changed("\"frames\": 500", "\"frames\": " + std::string(bad)),
                     "evaluation 1: expected an integer from 0 to 1000000000"));
    }
    CHECK(contains(changed("\"500\": {", "\" 500\": {"), "the number of a frame, found ' 500'"));
    CHECK(contains(changed("\"500\": {", "\"-5\": {"), "the number of a frame, found '-5'"));
    input.evaluations = {std::string(100'000, '[')};
    CHECK(contains(refusal(input), "nesting depth of at most 32"));
    Evaluation beyond = evaluation(6e-4, 9e-4);
    beyond.frames = 99;
    for (auto& [name, method] : beyond.methods) method.curve.resize(100);
    input.evaluations = {to_json(beyond)};
    CHECK(contains(refusal(input), "horizon 500 is beyond frame 99"));

    input.evaluations.clear();
    for (const char* bad : {"{", "{\"event\": \"step\"}", "{\"event\": \"lunch\"}", "7",
                            "{\"event\": \"fit\", \"alpha\": 1, \"b\": [1], \"residual\": 0}",
                            "[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[", "{\"event\": \"\x1b[31m\"}"}) {
      CAPTURE(bad);
      input.metrics = std::string(kMetrics) + bad + "\n";
      CHECK(contains(refusal(input), "metrics, line 5"));
      CHECK_FALSE(contains(refusal(input), "\x1b"));
    }
  }
}

TEST_SUITE("nmp/plot") {
  TEST_CASE("numbers have three digits, and a power of ten where they are small") {
    CHECK(pretty(0.5349) == "0.535");
    CHECK(pretty(12.36) == "12.4");
    CHECK(pretty(0) == "0");
    CHECK(pretty(6.123e-4) == "6.12 × 10⁻⁴");
    CHECK(pretty(9.9999e-4) == "1.00 × 10⁻³");
    CHECK(pretty(std::nan("")) == "not finite");
    CHECK(pretty(6.1e-4, 2e-5) == "6.10 ± 0.20 × 10⁻⁴");
    CHECK(pretty(0.535, 0.161) == "0.535 ± 0.161");
  }

  TEST_CASE("a curve is drawn where it has positive finite values") {
    LinePlot plot;
    Curve& curve = plot.curves.emplace_back();
    curve.label = "c";
    curve.x = {0, 1, 2, 3, 4};
    curve.y = {1, 1, std::nan(""), 1, 0};
    const std::string svg = draw(plot);
    CHECK(count(svg, "M") == 2);  // two pieces
    CHECK_FALSE(contains(svg, "nan"));
    plot.log_y = false;  // zero is as good as any value
    curve.y = {-1, 0, std::nan(""), 2, 1};
    const std::string linear = draw(plot);
    CHECK(count(linear, "M") == 2);
    CHECK(count(linear, "L") == 2);
    plot.curves.clear();
    CHECK(contains(draw(plot), "</svg>"));
  }
}

}  // namespace
}  // namespace nmp
