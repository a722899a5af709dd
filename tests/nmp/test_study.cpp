#include "nmp/study.h"

#include <algorithm>
#include <cmath>

#include "fem/cases.h"
#include "fem/mesh_cube.h"
#include "nmp/folder.h"
#include "nmp/picture.h"
#include "nmp/strain_range.h"
#include "nmp/study_tools.h"

using namespace nmp;
using fem::contains;

namespace {

std::size_t count(const std::string& text, const std::string& what) {
  std::size_t n = 0;
  for (std::size_t at = text.find(what); at != std::string::npos; at = text.find(what, at + 1)) ++n;
  return n;
}

}  // namespace

TEST_SUITE("nmp/study") {
  TEST_CASE("a camera looks along its direction: what is nearer, to the right, above") {
    const Camera front(-90, 0);  // from -y
    const auto p = front.project({1, -2, 3});
    CHECK(p.right == doctest::Approx(1));
    CHECK(p.up == doctest::Approx(3));
    CHECK(p.towards == doctest::Approx(2));
    const Camera above(-90, 90);
    CHECK(above.project({1, -2, 3}).up == doctest::Approx(-2));
    CHECK(above.project({1, -2, 3}).towards == doctest::Approx(3));
    Camera both(-90, 0);
    CHECK(both.width() == 0);
    both.include(Matrix<double>::Identity(3, 3));
    CHECK(both.width() == doctest::Approx(1));
    CHECK(both.height() == doctest::Approx(1));
    Matrix<double> lost = Matrix<double>::Constant(1, 3, std::nan(""));
    both.include(lost);
    CHECK(both.height() == doctest::Approx(1));
  }

  TEST_CASE("a picture shows the faces that look at the camera, the nearest last") {
    const auto mesh = fem::cube_mesh(2, 1);
    const fem::Surface surface = fem::extract_surface(mesh.tets());
    Camera front(-90, 0), corner(-60, 20);
    front.include(mesh.vertices());
    corner.include(mesh.vertices());
    PictureBody body{mesh.vertices(), {1, 0, 0}, {}, false};
    CHECK(count(draw("one face", surface, {body}, front), "<path") == 2);
    const std::string three = draw("<three> faces", surface, {body}, corner, 0.0);
    CHECK(count(three, "<path") == 6);
    CHECK(count(three, "<line") == 1);
    CHECK(contains(three, "&lt;three&gt;"));
    PictureBody behind = body;
    behind.x.col(1).array() += 5;
    behind.colour = {0, 0, 1};
    const std::string two = draw("two", surface, {body, behind}, front);
    CHECK(two.find("#00") < two.find("00\""));
    CHECK(two.rfind("fill=\"#00") < two.rfind("0000\""));  // blue first, red over it
    body.values.assign(3, 0.5);
    CHECK_THROWS_AS(draw("bad", surface, {body}, front), std::invalid_argument);
  }

  TEST_CASE("the range of strains holds what was included, and tells what goes beyond it") {
    const auto mesh = fem::cube_mesh(3, 1);
    StrainRange range;
    CHECK_FALSE(range.known());
    Matrix<double> x = mesh.vertices();
    x.col(0) *= 1.2;
    x.col(2) *= 0.7;
    range.include(strain_range(mesh, x));
    CHECK(range.known());
    CHECK(range.stretch_min == doctest::Approx(0.7));
    CHECK(range.stretch_max == doctest::Approx(1.2));
    CHECK(range.det_min == doctest::Approx(0.84));
    CHECK(range.det_max == doctest::Approx(1));
    CHECK_FALSE(range.exceeded_by(strain_range(mesh, x)));
    x.col(1) *= 1.25;
    CHECK(range.exceeded_by(strain_range(mesh, x)));  // stretch and det F
  }

  TEST_CASE("every kind of study has a name of its own") {
    std::vector<std::string> names;
    for (const StudyKind& kind : study_kinds()) names.emplace_back(kind.name);
    CHECK(names.size() == 14);
    std::sort(names.begin(), names.end());
    CHECK(std::adjacent_find(names.begin(), names.end()) == names.end());
  }

  TEST_CASE("a report has a section for every study that was kept, its text escaped") {
    const test::Folder folder;
    Study study{"unseen",     "A <title>", {"note"}, {{"a", "b"}, {"1", "<2>"}},
                "{\"x\": 1}", "<svg/>"};
    const Path report = add_to_report(study, folder.path());
    study.name = "volume";
    CHECK(add_to_report(study, folder.path()) == report);
    const std::string html = read_text(report, 1 << 20);
    CHECK(contains(html, "<section id=\"unseen\">"));
    CHECK(contains(html, "<section id=\"volume\">"));
    CHECK(contains(html, "A &lt;title&gt;"));
    CHECK(contains(html, "<td>&lt;2&gt;</td>"));
    CHECK(contains(html, "<svg/>"));
    write_text(folder / "studies/unseen.json", "{");
    CHECK_THROWS_WITH_AS(add_to_report(study, folder.path()), doctest::Contains("unseen.json"),
                         InputError);
  }

  TEST_CASE("errors to colour by are parts of a scale") {
    Matrix<double> x = Matrix<double>::Zero(2, 3), y = x;
    y(0, 1) = 0.5;
    y(1, 2) = 7;
    CHECK(study::error_values(y, x, 2) == std::vector<double>{0.25, 1});
    CHECK(study::mean_and_spread({}) == "-");
    CHECK(study::mean_and_spread({0.5}) == "0.5");
    CHECK(study::mean_and_spread({1, 3}) == "2 +- 1");
  }
}
