#pragma once

#include <string>

#include "nmp/player_data.h"

/// The player as part of a page.
namespace nmp::report {

/// The player with what it shows, and a note on what is stored and what the colours mean.
std::string player_figure(const PlayerDocument& document);
/// What a page with a player needs: page/player.css, and page/player*.js as one script.
std::string player_styles();
std::string player_script();

/// A whole page that needs no network and holds nothing but a player: `nmp view`.
std::string view_page(const std::string& title, const PlayerDocument& document);

}  // namespace nmp::report
