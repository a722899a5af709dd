// Documents of nmp eval --json, as a report reads and draws them.
#include "fuzz/fuzz.h"
#include "nmp/report.h"

using namespace nmp;

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  ReportInput input;
  input.evaluations = {fuzz::text_of(data, size)};
  return fuzz::run([&] { return make_report(input); },
                   [](const std::string& html) { fuzz::touch(html.data(), html.size()); });
}
