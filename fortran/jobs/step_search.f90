! Optimize: -O1
!> Search for the step of a motion: halved until the kept states are as exact as required.
!!
!! The difference of two runs, one with half the step size of the other, is the error of the
!! coarser one, so the finer one is at least as accurate, and of smooth motions far more. Further
!! runs find errors that these two do not show: amplified rounding errors, by a system with numbers
!! changed by 1e-12 (`shaken`), and equal errors of both runs at kinks of laws, by another step
!! length.
module viscovib_step_search
  use viscovib_event_errors, only: differences_type, find_differences, set_error
  use viscovib_kinds, only: i8, wp
  use viscovib_motion_request, only: solved_to_rounding => rounding, transient_job
  use viscovib_piece_runs, only: piece_runs
  use viscovib_status, only: set_ok, status_type
  use viscovib_time_run, only: run_coarse, run_completed, run_stopped
  use viscovib_trajectory, only: change_of, compare, grown_of, hopeless, max_halvings, off_of, &
    risen, trajectory_type
  implicit none
  private

  public :: estimate_error, find_step, search_type

  !> Outcome of a search.
  integer, parameter, public :: step_found = 0, step_not_met = 1, step_in_layer = 2, &
                                step_grown = 3, step_too_many = 4

  !> Bounds of steps and of stored numbers, which reject typing errors that would fill the memory or
  !! take a year.
  real(wp), parameter, public :: max_steps = 1.0e12_wp, max_numbers = 2.0_wp**27
  !> Smallest number of steps before a stop for a comparison of runs: a first step with memory ends
  !! like the second step of half its length, and a failed step is resolved by small steps in
  !! both runs.
  integer, parameter :: few = 4
  !> Largest number of steps for resolving a thin layer of a law.
  real(wp), parameter :: most_for_layers = 65536.0_wp
  !> Length of steps that polynomials resolve, relative to that which nodes resolve.
  real(wp), parameter :: followed = 0.05_wp
  !> Relative height of peaks between kept states above these states; largest numbers of states
  !! and of parts of a step that are kept for this.
  real(wp), parameter :: peaks = 2.0e-3_wp, most_states = 1.0e5_wp
  integer, parameter :: most_parts = 64
  !> Parts of a step at whose ends polynomials are compared.
  integer, parameter :: compared = 4
  !> Safety factor of gains by halving the step; largest relative difference of runs that follow a
  !! smooth motion, so that half the step gains.
  real(wp), parameter :: less_sure = 8.0_wp, followed_by_both = 1.0e-4_wp
  !> Largest gain by half the step of states between ends of steps that are not exact enough.
  real(wp), parameter :: gain_between = 2.0_wp**15
  !> Error of states inside steps of half the length, relative to the last coefficients of the first
  !! steps.
  real(wp), parameter :: of_resolution = 0.1_wp
  !> Largest change of the motion in a first step, relative to its size.
  real(wp), parameter :: of_equations = 1.6_wp
  !> Relative difference at which a run is close enough to the motion to determine amplified
  !! rounding errors; rounding error of a motion that does not amplify it.
  real(wp), parameter :: near = 1.0e-3_wp, few_roundings = 64.0_wp*4.0_wp*epsilon(1.0_wp)
  !> Largest relative difference of two runs on the way to a last state.
  real(wp), parameter :: one_motion = 1.0e-6_wp
  !> Smallest number of states kept by a run that stops; largest number of halvings of the step
  !! for their accuracy.
  integer, parameter :: states_at_stop = 100, halvings_at_stop = 6
  !> Relative size of a motion that has diverged.
  real(wp), parameter :: away = 10.0_wp

  !> Result of a search.
  type :: search_type
    integer :: verdict = step_found
    !> The run, with its error; if no step is found: the last run, and the one before.
    type(trajectory_type) :: run, coarse
    !> Change between two step sizes; amplified rounding errors.
    real(wp) :: change = 0.0_wp, grown = 0.0_wp
    !> Factor by which its steps are shorter than the first, and states kept per first step.
    integer :: factor = 1, per_step = 1
    !> True if a run with changed numbers has determined the amplified rounding errors.
    logical :: was_shaken = .false.
  end type search_type

  !> Amplified rounding errors of a motion, for each row of states (not allocated: not computed),
  !! and the first run that is close enough to determine them, with steps shorter by `factor`.
  type :: growth_type
    type(trajectory_type) :: run
    integer :: factor = 0
    real(wp), allocatable :: grown(:)
  end type growth_type

  !> Largest differences of the polynomials of a run from those of twice the step, in each first
  !! step, shape (rows, n), and of the runs before; not allocated: not known.
  type :: inside_type
    real(wp), allocatable :: off(:, :), before(:, :)
  contains
    procedure :: error_of_finer
  end type inside_type

contains

  !> Runs with decreasing step size, n steps at first, until the tolerance is met.
  subroutine find_step(runs, job, n, search, status)
    type(piece_runs), intent(in) :: runs
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    type(search_type), intent(out) :: search
    type(status_type), intent(out) :: status
    type(trajectory_type) :: coarse, fine, before, ends
    type(growth_type) :: growth
    type(inside_type) :: inside
    real(wp), allocatable :: lost(:)
    real(wp) :: changes(max_halvings), part
    integer :: by, held, least, n_changes, parts, times
    logical :: fills, done, goes_on, met

    fills = job%fills .and. job%save_every == 1 .and. .not. job%last_only
    if (runs%is_smooth()) runs%shared%solved = job%solved_if_smooth(n, job%wanted())
    held = parts_of(runs, n, fills, 1, 1)
    call make_run(runs, job, n, 1, held, coarse, before, search, goes_on, status)
    if (.not. goes_on) return
    least = 1
    if (held > 1) least = parts_for_peaks(before)
    if (runs%is_smooth()) then
      part = minval(job%allowed(before))/max(maxval(before%sizes()), 1.0e-300_wp)
      runs%shared%solved = min(runs%shared%solved, job%solved_if_smooth(n, part))
    end if
    n_changes = 0
    by = 2
    if (fills .and. 4.0_wp*n <= most_states) by = first_division(runs, job, coarse, before)
    do
      if (by > 1) then
        parts = parts_of(runs, n, fills, by*search%factor, least)
        if (cannot_be_made(job, n, by*search%factor, parts, size(before%states, 1))) then
          if (n_changes == 0) search%verdict = step_too_many
          exit
        end if
        search%factor = by*search%factor
        call make_run(runs, job, n, search%factor, parts, fine, ends, search, goes_on, status)
      else
        ! The run with a quarter of the step is exact enough if that with half of it is.
        by = 2
        held = parts_of(runs, n, fills, search%factor/2, 1)
        call make_run(runs, job, n, search%factor/2, held, coarse, before, search, goes_on, status)
      end if
      if (.not. goes_on) return
      call runs%align(before, ends)
      if (held > 1 .and. runs%goes_inside()) then
        call look_inside(runs, coarse, held, fine, parts, inside)
      end if
      call compare_runs(runs, job, n, search%factor, before, ends, lost, search%change, met, status)
      if (status%failed()) return
      call look_at_growth(runs, job, n, by, before, ends, growth, met, search, status)
      if (status%failed()) return
      if (search%verdict /= step_found) then
        call give_up(before, ends, search)
        return
      end if
      times = 0
      if (met .and. fine%too_long > 1.0_wp) then
        ! Two runs may agree because both have missed a layer.
        times = shorter_by(fine)
      else if (met) then
        call finish(runs, job, n, fine, parts, before, ends, inside, search, done, status)
        if (done .or. status%failed()) return
      else if (by > 2) then
        by = 1
        cycle
      else
        n_changes = n_changes + 1
        changes(n_changes) = search%change
        if (outruns(runs, coarse, fine)) exit
        ! Halving has no effect before the arguments of laws are resolved.
        if (hopeless(changes(:n_changes)) .and. fine%outcome == run_completed &
            .and. fine%too_long > followed) times = shorter_by(fine)
        if (times > 0) n_changes = 0
        if (hopeless(changes(:n_changes))) exit
      end if
      if (times > 0) then
        if (real(n, wp)*search%factor*times > most_for_layers) then
          search%verdict = step_in_layer
          search%factor = search%factor*times
          call give_up(before, ends, search)
          return
        end if
        search%factor = search%factor*times
        parts = parts_of(runs, n, fills, search%factor, least)
        call make_run(runs, job, n, search%factor, parts, fine, ends, search, goes_on, status)
        if (.not. goes_on) return
        inside = inside_type()
      end if
      call coarse%become(fine)
      call before%become(ends)
      held = parts
      if (by > 2) inside = inside_type()
      by = 2
    end do
    if (search%verdict == step_found) search%verdict = step_not_met
    call give_up(before, ends, search)
  end subroutine find_step

  !> A run, and its states at the ends of first steps. The search ends if it fails or is stopped.
  subroutine make_run(runs, job, n, factor, parts, run, ends, search, goes_on, status)
    type(piece_runs), intent(in) :: runs
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    !> States that it keeps in each first step.
    integer, intent(in) :: factor, parts
    type(trajectory_type), intent(out) :: run, ends
    type(search_type), intent(inout) :: search
    logical, intent(out) :: goes_on
    type(status_type), intent(out) :: status
    goes_on = .false.
    call runs%make(job, n, factor, parts, run, status)
    if (status%failed()) return
    goes_on = run%outcome /= run_stopped
    if (goes_on) then
      call run%thin(parts, ends)
    else
      search%run = run
    end if
  end subroutine make_run

  !> Return the last two runs at the ends of first steps, for the message; if they are no longer
  !! known, the last one.
  subroutine give_up(before, ends, search)
    type(trajectory_type), intent(in) :: before, ends
    type(search_type), intent(inout) :: search
    if (allocated(ends%states)) then
      search%run = ends
      search%coarse = before
    else
      search%run = before
    end if
  end subroutine give_up

  !> States that a run keeps in each first step: of polynomials enough to compare them, but at
  !! least `least`, of a smooth motion all ends of steps.
  integer function parts_of(runs, n, fills, factor, least)
    type(piece_runs), intent(in) :: runs
    integer(i8), intent(in) :: n
    !> True if states inside steps are wanted.
    logical, intent(in) :: fills
    integer, intent(in) :: factor, least
    parts_of = 1
    if (.not. fills) return
    if (runs%goes_inside()) then
      parts_of = max(min(compared*factor, most_of_step(n)), least)
    else if (runs%is_smooth() .and. real(n, wp)*factor <= most_states) then
      parts_of = factor
    end if
  end function parts_of

  !> True if the number of steps or of stored numbers would be too large.
  pure logical function cannot_be_made(job, n, factor, parts, rows)
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    !> Numbers of a state, and states kept in a first step.
    integer, intent(in) :: factor, parts, rows
    cannot_be_made = real(n, wp)*factor > max_steps
    if (job%last_only) return
    cannot_be_made = cannot_be_made .or. real(n, wp)*parts/job%save_every > max_numbers/rows
  end function cannot_be_made

  !> Factor by which to shorten the first step, 4 if states inside steps of half the length would
  !! not be exact enough: the first run shows this.
  integer function first_division(runs, job, coarse, before) result(by)
    type(piece_runs), intent(in) :: runs
    class(transient_job), intent(in) :: job
    !> The run, and its ends of steps.
    type(trajectory_type), intent(in) :: coarse, before
    type(trajectory_type) :: ends
    type(status_type) :: status
    real(wp), dimension(size(before%states, 1)) :: allowed, off
    by = 2
    if (before%outcome /= run_completed .or. parts_for_peaks(before) <= 2) return
    allowed = job%allowed(before)
    if (runs%is_smooth()) then
      allowed = gain_between*allowed
      call runs%fill(coarse, 1, allowed, ends, off, status)
      if (.not. all(off <= allowed) .and. all(off < huge(1.0_wp))) by = 4
    else if (runs%goes_inside() .and. runs%gain(2) > 1.0_wp &
             .and. .not. (runs%keeps_all() .or. runs%renames())) then
      if (any(of_resolution*before%resolution*before%sizes() > allowed)) by = 4
    end if
  end function first_division

  !> Factor by which to shorten steps so that nodes are inside layers: the thickness of a layer
  !! shows only when the steps are close to it.
  pure integer function shorter_by(run)
    type(trajectory_type), intent(in) :: run
    shorter_by = merge(2, 4, run%too_long <= 2.0_wp)
  end function shorter_by

  !> Difference of a run from a run with two or four times the step size, and whether both meet the
  !! tolerance. Both runs may have the same error from a kink next to an end of all their steps. A
  !! run with one more step for each first step has different ends of steps.
  subroutine compare_runs(runs, job, n, factor, coarse, fine, lost, change, met, status)
    type(piece_runs), intent(in) :: runs
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    integer, intent(in) :: factor
    type(trajectory_type), intent(inout) :: coarse, fine
    !> As in `compare`.
    real(wp), allocatable, intent(inout) :: lost(:)
    real(wp), intent(out) :: change
    logical, intent(out) :: met
    type(status_type), intent(out) :: status
    type(trajectory_type) :: other
    real(wp), dimension(size(fine%states, 1)) :: allowed, off
    real(wp) :: apart, gain
    call set_ok(status)
    apart = parted(runs, job, coarse, fine)
    change = max(change_of(coarse, fine), apart)
    if (change < huge(1.0_wp) .and. fine%outcome == run_completed) then
      allowed = job%allowed(fine)
      gain = 1.0_wp
      ! Shorter steps do not reduce rounding errors.
      if (change <= followed_by_both*maxval(fine%sizes()) &
          .and. all(epsilon(1.0_wp)*fine%sizes() <= allowed)) then
        gain = runs%gain(nint(coarse%h/fine%h)/2)
      end if
      off = off_of(coarse, fine)
      met = .not. apart > 0.0_wp .and. all(off <= gain*allowed)
      if (met .and. gain > 1.0_wp) then
        ! No more of the gain than is needed.
        gain = min(gain, max(less_sure, maxval(off/max(allowed, tiny(1.0_wp)))))
        change = change/gain
        if (runs%is_smooth()) change = max(change, of_equations*n*maxval(fine%sizes()) &
                                           *(fine%solved - solved_to_rounding))
      end if
    else
      allowed = job%allowed_at_stop(fine)
      met = change <= allowed(1) .and. (fine%n_steps == 0 .or. fine%n_steps >= few)
    end if
    if (.not. fine%over_kinks) return
    if (met .and. allocated(lost)) then
      call runs%make(job, n, factor + 1, 1, other, status)
      if (status%failed()) return
      call runs%align(other, fine)
      lost = max(lost, off_of(other, fine))
    end if
    call compare(coarse, fine, allowed, lost, change, met)
  end subroutine compare_runs

  !> Include amplified rounding errors: computed once, roughly, and only if the present runs do
  !! not determine them.
  subroutine look_at_growth(runs, job, n, by, coarse, fine, growth, met, search, status)
    type(piece_runs), intent(in) :: runs
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    !> Ratio of the step sizes.
    integer, intent(in) :: by
    type(trajectory_type), intent(inout) :: coarse, fine
    type(growth_type), intent(inout) :: growth
    logical, intent(in) :: met
    type(search_type), intent(inout) :: search
    type(status_type), intent(out) :: status
    real(wp) :: allowed(size(fine%states, 1)), rise
    call set_ok(status)
    search%grown = 0.0_wp
    if (growth%factor == 0 &
        .and. (met .or. search%change <= near*maxval(abs(fine%states)))) then
      growth%run = coarse
      growth%factor = search%factor/by
    end if
    ! Runs before and after a thin layer was found have different parts of steps.
    if (.not. met) return
    if (.not. allocated(growth%grown)) then
      if (runs%goes_in_parts()) return
      rise = risen(coarse, fine, job%allowed(fine))
      if (rise < huge(1.0_wp)) then
        search%grown = rise
        search%change = max(search%change, rise)
        return
      end if
      call grow(runs, job, n, growth%factor, growth%run, growth%grown, status)
      if (status%failed() .or. .not. allocated(growth%grown)) return
      if (.not. all(growth%grown < huge(1.0_wp)) .and. growth%factor /= search%factor) then
        ! A coarse run may stop where a finer one does not.
        call grow(runs, job, n, search%factor, fine, growth%grown, status)
        if (status%failed() .or. .not. allocated(growth%grown)) return
      end if
    end if
    search%grown = maxval(growth%grown)
    search%change = max(search%change, search%grown)
    allowed = job%allowed_at_stop(fine)
    if (fine%outcome == run_completed) allowed = job%allowed(fine)
    if (.not. all(growth%grown <= allowed)) search%verdict = step_grown
  end subroutine look_at_growth

  !> Amplified rounding errors along a run, for each row of states, by runs of a system with changed
  !! numbers; not allocated if there are none. The effects of the start and of the numbers may
  !! cancel: if the errors grow, both signs are used.
  subroutine grow(runs, job, n, factor, run, grown, status)
    type(piece_runs), intent(in) :: runs
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    integer, intent(in) :: factor
    type(trajectory_type), intent(inout) :: run
    real(wp), allocatable, intent(out) :: grown(:)
    type(status_type), intent(out) :: status
    type(trajectory_type) :: other
    integer :: sign
    do sign = 1, -1, -2
      call runs%make_shaken(job, n, factor, sign, other, status)
      if (status%failed() .or. .not. allocated(other%states)) return
      call runs%align(other, run)
      if (sign == 1) then
        allocate (grown, source=grown_of(run, other))
      else
        grown = max(grown, grown_of(run, other))
      end if
      if (all(grown <= few_roundings*maxval(abs(run%states)))) return
    end do
  end subroutine grow

  !> Difference on the way of two runs that keep only the last state, if it shows that they are
  !! different motions, else 0: chaotic runs may have the same end by chance.
  real(wp) function parted(runs, job, coarse, fine) result(change)
    type(piece_runs), intent(in) :: runs
    class(transient_job), intent(in) :: job
    type(trajectory_type), intent(in) :: coarse, fine
    type(trajectory_type) :: one, other
    real(wp), allocatable :: off(:), allowed(:)
    change = 0.0_wp
    if (.not. (allocated(coarse%looks) .and. allocated(fine%looks))) return
    if (size(coarse%looks, 2) /= size(fine%looks, 2) .or. size(fine%looks, 2) == 0) return
    one%t = coarse%looks(1, :)
    other%t = fine%looks(1, :)
    allocate (one%states, source=coarse%looks)
    allocate (other%states, source=fine%looks)
    call runs%align(one, other)
    allocate (off, source=maxval(abs(other%states - one%states), 2))
    allocate (allowed, source=max(job%allowed(other), one_motion*maxval(abs(other%states), 2)))
    if (any(off > allowed)) change = maxval(off)
  end function parted

  !> True if the motion is too fast for its laws, with the largest number of parts in steps of any
  !! length: two failed runs end at the same time, far from their start.
  logical function outruns(runs, coarse, fine)
    type(piece_runs), intent(in) :: runs
    type(trajectory_type), intent(in) :: coarse, fine
    outruns = .false.
    if (.not. runs%goes_in_parts() .or. size(fine%t) == 0) return
    if (coarse%outcome /= run_coarse .or. fine%outcome /= run_coarse) return
    outruns = min(coarse%t_reached, fine%t_reached) > coarse%h &
              .and. abs(fine%t_reached - coarse%t_reached) <= coarse%h &
              .and. maxval(abs(fine%states(:, size(fine%t)))) &
              > away*maxval(abs(fine%states(:, 1)))
  end function outruns

  !> For two runs that agree at ends of steps, return the finer one with the requested states.
  !! `done` is false if states inside its steps are inaccurate, so that shorter steps are needed.
  subroutine finish(runs, job, n, fine, parts, before, ends, inside, search, done, status)
    type(piece_runs), intent(in) :: runs
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    !> The finer run, with its states per first step; both runs at the ends of first steps.
    type(trajectory_type), intent(inout) :: fine, before, ends
    integer, intent(in) :: parts
    type(inside_type), intent(in) :: inside
    type(search_type), intent(inout) :: search
    logical, intent(out) :: done
    type(status_type), intent(out) :: status
    type(differences_type) :: differences
    real(wp) :: off(size(ends%states, 1))
    integer :: needed
    logical :: again

    call set_ok(status)
    done = .true.
    needed = 1
    off = 0.0_wp
    search%per_step = 1
    if (ends%outcome /= run_completed) search%run = ends
    if (job%fills .and. job%save_every == 1 .and. .not. (job%last_only .or. runs%keeps_all())) then
      if (ends%outcome == run_completed) then
        needed = parts_for_peaks(ends)
      else
        call fill_to_stop(runs, job, n, ends, search, status)
        if (status%failed()) return
      end if
    end if
    if (ends%outcome == run_completed) then
      again = needed > parts
      if (.not. again) then
        call fine%thin(parts/needed, search%run)
        if (needed > search%factor) off = inside%error_of_finer(runs, job, before, ends)
      else if (parts == search%factor .and. runs%is_smooth()) then
        call runs%fill(fine, needed/parts, job%allowed(ends), search%run, off, status)
        if (status%failed()) return
        again = .false.
      end if
      if (.not. all(off <= job%allowed(ends))) then
        done = needed <= 2*search%factor
        if (.not. done) return
        again = .true.
      end if
      if (again) then
        search%factor = max(search%factor, needed)
        call runs%make(job, n, search%factor, needed, search%run, status)
        if (status%failed()) return
      else
        search%per_step = max(needed/search%factor, 1)
        search%change = max(search%change, maxval(off))
      end if
    end if
    call find_differences(before, ends, search%grown, .not. runs%renames(), differences)
    call set_error(search%run, before, search%change, differences, job%watched)
  end subroutine finish

  !> Add differences of the polynomials of two runs, of which one has half the step.
  subroutine look_inside(runs, coarse, held, fine, parts, inside)
    type(piece_runs), intent(in) :: runs
    type(trajectory_type), intent(inout) :: coarse, fine
    !> States per first step.
    integer, intent(in) :: held, parts
    type(inside_type), intent(inout) :: inside
    type(trajectory_type) :: one, other
    integer :: i, per

    if (allocated(inside%off)) call move_alloc(inside%off, inside%before)
    if (coarse%outcome /= run_completed .or. fine%outcome /= run_completed) return
    per = min(held, parts)
    call coarse%thin(held/per, one)
    call fine%thin(parts/per, other)
    call runs%align(one, other)
    allocate (inside%off(size(one%states, 1), (size(one%t) - 1)/per))
    do i = 1, size(inside%off, 2)
      associate (first => (i - 1)*per + 2, last => i*per + 1)
        inside%off(:, i) = maxval(abs(other%states(:, first:last) - one%states(:, first:last)), 2)
      end associate
    end do
  end subroutine look_inside

  !> Error of the polynomials of the finer of the last two runs, for each row of states. The
  !! differences are those of the coarser one; three runs show the gain by halving in each first
  !! step. The last coefficients of two runs show it for the whole motion; no more of this gain is
  !! used than is needed.
  function error_of_finer(self, runs, job, coarse, fine) result(off)
    class(inside_type), intent(in) :: self
    type(piece_runs), intent(in) :: runs
    class(transient_job), intent(in) :: job
    type(trajectory_type), intent(in) :: coarse, fine
    real(wp) :: off(size(self%off, 1)), most
    real(wp), dimension(size(self%off, 1), size(self%off, 2)) :: gain

    gain = 1.0_wp
    if (.not. (runs%equations%over_kinks .or. runs%renames())) then
      most = (coarse%h/fine%h)**runs%equations%nodes/less_sure
      if (allocated(self%before)) then
        gain = self%before/(less_sure*max(self%off, epsilon(1.0_wp)*self%before, 1.0e-300_wp))
      else
        off = maxval(self%off, 2)/max(job%allowed(fine), tiny(1.0_wp))
        most = min(most, less_sure*maxval(off))
        gain = coarse%resolution/(2.0_wp*less_sure*max(fine%resolution, 1.0e-300_wp, &
                                                       epsilon(1.0_wp)*coarse%resolution))
      end if
      gain = max(1.0_wp, min(gain, most))
    end if
    off = maxval(self%off/gain, 2)
  end function error_of_finer

  !> Number of states per step for low peaks between them, a power of 2: a displacement
  !! rises by at most |u''| d^2/8 between states d apart.
  pure integer function parts_for_peaks(run) result(parts)
    type(trajectory_type), intent(in) :: run
    real(wp) :: needed, largest, rise
    integer :: i, k, m

    parts = 1
    m = size(run%t)
    if (m < 2) return
    ! In so short a time rates overflow, and so do peaks between states.
    if (run%t(m) - run%t(1) < 1.0e-290_wp) return
    needed = 1.0_wp
    do i = 1, size(run%states, 1), 2
      largest = maxval(abs(run%states(i, :)))
      if (.not. largest > 0.0_wp) cycle
      rise = 0.0_wp
      do k = 2, m
        ! Steps of a quarter period underestimate curvatures.
        rise = max(rise, abs(run%states(i + 1, k) - run%states(i + 1, k - 1)) &
                   *(run%t(k) - run%t(k - 1)))
      end do
      needed = max(needed, 0.2_wp*rise/(peaks*largest))
    end do
    do while (parts < min(most_parts, most_of_step(int(m - 1, i8))) &
              .and. needed > real(parts, wp)**2)
      parts = 2*parts
    end do
  end function parts_for_peaks

  !> Largest number of states per step in n steps, a power of 2.
  pure integer function most_of_step(n) result(most)
    integer(i8), intent(in) :: n
    most = 1
    do while (most < most_parts .and. 2.0_wp*most*real(n, wp) <= most_states)
      most = 2*most
    end do
  end function most_of_step

  !> Keep enough states of a run that stops. Some of them are nearer
  !! to the stop than the compared states. Errors grow with a diverging motion, so
  !! they are compared with runs with shorter steps.
  subroutine fill_to_stop(runs, job, n, run, search, status)
    type(piece_runs), intent(in) :: runs
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    type(trajectory_type), intent(in) :: run
    type(search_type), intent(inout) :: search
    type(status_type), intent(out) :: status
    type(trajectory_type) :: more, finer
    real(wp) :: error
    integer :: i, parts, steps

    call set_ok(status)
    search%run = run
    parts = 1
    do while (parts < most_parts .and. parts*max(size(run%t) - 1, 1) < states_at_stop)
      parts = 2*parts
    end do
    if (parts == 1) return
    steps = max(search%factor, parts)
    call runs%make(job, n, steps, parts, finer, status)
    do i = 1, halvings_at_stop
      if (status%failed()) return
      more = finer
      steps = 2*steps
      call runs%make(job, n, steps, parts, finer, status)
      if (status%failed()) return
      if (finer%outcome /= run%outcome) return
      call runs%align(more, finer)
      error = change_of(more, finer)
      if (error > job%allowed_at_stop(finer)) cycle
      search%change = max(search%change, error)
      search%run = finer
      search%factor = steps
      return
    end do
  end subroutine fill_to_stop

  !> A run in n steps and its error, from a run with half the step size, and over kinks also with a
  !! third of it: runs with half the step size may have the same error from a kink next to the end
  !! of a step. Errors decrease slowly there, so finer runs have a large part of them with the same
  !! sign, which their difference shows.
  subroutine estimate_error(runs, job, n, search, status)
    type(piece_runs), intent(in) :: runs
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    type(search_type), intent(out) :: search
    type(status_type), intent(out) :: status
    type(trajectory_type) :: half, third
    type(differences_type) :: differences
    real(wp), allocatable :: grown(:)

    call runs%make(job, n, 1, 1, search%run, status)
    if (status%failed() .or. search%run%outcome == run_stopped) return
    call runs%make(job, n, 2, 1, half, status)
    if (status%failed()) return
    call runs%align(half, search%run)
    search%change = change_of(search%run, half)
    if (search%run%over_kinks) then
      call runs%make(job, n, 3, 1, third, status)
      if (status%failed()) return
      call runs%align(third, search%run)
      search%change = max(search%change, change_of(search%run, third))
      if (search%change < huge(1.0_wp)) search%change = search%change + change_of(half, third)
    end if
    if (.not. runs%goes_in_parts()) then
      search%grown = risen(search%run, half, 0.0_wp*search%run%sizes())
      if (.not. search%grown < huge(1.0_wp)) then
        call grow(runs, job, n, 1, search%run, grown, status)
        if (status%failed()) return
        search%was_shaken = allocated(grown)
        search%grown = 0.0_wp
        if (search%was_shaken) search%grown = maxval(grown)
      end if
      search%change = max(search%change, search%grown)
    end if
    call find_differences(half, search%run, search%grown, .not. runs%renames(), differences)
    call set_error(search%run, half, search%change, differences, job%watched)
  end subroutine estimate_error

end module viscovib_step_search
