!> A motion in time of a polynomial system without memory, or with one of exponentials, as one job.
module viscovib_polynomial_job
  use viscovib_constants, only: pi
  use viscovib_counters, only: count_up, counted_idle, counting
  use viscovib_fitted_memory, only: needs_fit, shared_error, tell_fit
  use viscovib_hidden_memory, only: count_hidden
  use viscovib_hidden_start, only: begin_hidden
  use viscovib_kinds, only: i8, wp
  use viscovib_law_program, only: branches
  use viscovib_load, only: load_type
  use viscovib_plan_text, only: tell_idle, tell_laws, tell_zeros
  use viscovib_polynomial, only: polynomial_type
  use viscovib_fitted_motion, only: new_fitted_motion
  use viscovib_polynomial_motion, only: polynomial_motion_type
  use viscovib_reduction, only: moved_coordinates, reduce, state_mask
  use viscovib_status, only: set_ok, status_type, things
  use viscovib_trajectory, only: shaken
  use viscovib_transient_job, only: driven_runs, first_steps, make_runs, run_maker, &
    run_transient, trajectory_type, transient_job
  use viscovib_transient_plan, only: plan_transient
  implicit none
  private

  public :: run_polynomial_job, plan_polynomial

  !> How far beyond its end a run may go on in Python: sums that stand for kernels reach as far.
  real(wp), parameter :: furthest = 100.0_wp

  !> Runs of a system whose kernels are taken as sums of exponentials.
  type, extends(run_maker) :: fitted_runs
    type(polynomial_type), pointer :: remembering => null()
    type(load_type), pointer :: load => null()
    real(wp) :: nu = 0.0_wp
    type(polynomial_motion_type), pointer :: motion => null()
    !> As of `driven_runs`.
    type(polynomial_type), pointer :: other => null()
  contains
    procedure :: make => make_fitted
    procedure :: make_shaken => make_other
    procedure :: goes_in_parts
  end type fitted_runs

contains

  !> The motion wanted; coordinates that nothing moves are left out of the equations.
  subroutine run_polynomial_job(job, system, load, nu, fastest, trajectory, status)
    type(transient_job), intent(in) :: job
    type(polynomial_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Circular frequency of the load; fastest frequency of system and load (rad/s).
    real(wp), intent(in) :: nu, fastest
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(polynomial_type) :: reduced
    type(transient_job) :: part_job
    type(load_type) :: part
    logical :: moved(system%n_dof())

    moved = moved_coordinates(system, driven(job, system, load))
    if (all(moved)) then
      call run_whole(job, system, load, nu, fastest, trajectory, status)
      return
    end if
    call reduce(system, moved, reduced)
    call load%take_part(moved, part)
    part_job = job
    part_job%initial = pack(job%initial, state_mask(moved))
    if (allocated(job%held)) part_job%held = pack(job%held, moved)
    call run_whole(part_job, reduced, part, nu, fastest, trajectory, status)
    if (.not. status%failed()) call trajectory%spread_out(moved)
  end subroutine run_polynomial_job

  !> Coordinates that the load or the start moves; of a watched motion all are computed, and where
  !! laws switch: what they know is kept in one order, whatever acts later on.
  pure function driven(job, system, load)
    type(transient_job), intent(in) :: job
    type(polynomial_type), intent(in) :: system
    type(load_type), intent(in) :: load
    logical :: driven(size(job%initial)/2)
    integer :: i
    driven = load%drives(system) .or. abs(job%initial(1::2)) > 0.0_wp &
             .or. abs(job%initial(2::2)) > 0.0_wp .or. allocated(job%watched)
    if (allocated(job%held)) driven = driven .or. abs(job%held) > 0.0_wp
    do i = 1, size(system%laws)
      driven = driven .or. system%laws(i)%state > 0 .or. any(branches(system%laws(i)%program%code))
    end do
  end function driven

  logical function goes_in_parts(self)
    class(fitted_runs), intent(in) :: self
    goes_in_parts = self%motion%in_parts
  end function goes_in_parts

  !> Of a run of n*factor steps kernels are fitted for these.
  subroutine make_fitted(self, job, n, factor, parts, trajectory, status)
    class(fitted_runs), intent(in) :: self
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    integer, intent(in) :: factor, parts
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(driven_runs) :: runs
    type(polynomial_type) :: taken
    real(wp) :: longest
    logical :: in_parts

    ! What runs before have met of thin layers.
    longest = self%motion%longest
    in_parts = self%motion%in_parts
    call new_fitted_motion(self%motion, self%remembering, self%load, self%nu, &
                           job%t_end/real(n*factor, wp), furthest*job%t_end, status, taken)
    if (status%failed()) return
    if (allocated(job%held)) then
      call begin_hidden(self%motion, self%remembering, taken, job%held, status)
      if (status%failed()) return
    end if
    self%motion%longest = longest
    self%motion%in_parts = in_parts
    runs%system => self%motion
    call runs%make(job, n, factor, parts, trajectory, status)
    trajectory%represented = shared_error
  end subroutine make_fitted

  subroutine make_other(self, job, n, factor, sign, trajectory, status)
    class(fitted_runs), intent(in) :: self
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    integer, intent(in) :: factor, sign
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(fitted_runs) :: maker
    class(transient_job), allocatable :: begun
    call set_ok(status)
    if (self%motion%in_parts) return
    maker = self
    maker%remembering => self%other
    allocate (begun, source=job)
    begun%initial = job%initial*(1.0_wp + sign*shaken)
    call maker%make(begun, n, factor, 1, trajectory, status)
  end subroutine make_other

  !> The same with all coordinates.
  subroutine run_whole(job, system, load, nu, fastest, trajectory, status)
    type(transient_job), intent(in) :: job
    type(polynomial_type), intent(in), target :: system
    type(load_type), intent(in), target :: load
    real(wp), intent(in) :: nu, fastest
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(polynomial_motion_type), target :: motion, other_motion
    type(polynomial_type), target :: other
    type(fitted_runs) :: maker

    call new_fitted_motion(motion, system, load, nu, 1.0_wp, 1.0_wp, status)
    if (status%failed()) return
    if (counting) call count_up(counted_idle, count( &
                                .not. moved_coordinates(system, driven(job, system, load))))
    ! With the start forces have other arguments, u/(1 + s), and other values, by 1 + 2 s.
    other = system
    other%mass = system%mass*(1.0_wp - 2.0_wp*shaken)
    if (.not. needs_fit(system)) then
      call new_fitted_motion(other_motion, other, load, nu, 1.0_wp, 1.0_wp, status)
      if (status%failed()) return
      if (allocated(job%held)) then
        call begin_hidden(motion, system, system, job%held, status)
        if (.not. status%failed()) call begin_hidden(other_motion, other, other, job%held, status)
        if (status%failed()) return
      end if
      call run_transient(job, motion, fastest, trajectory, status, other_motion)
      return
    end if
    maker%remembering => system
    maker%load => load
    maker%nu = nu
    maker%motion => motion
    maker%other => other
    call make_runs(maker, job, job%t_end*fastest/(0.5_wp*pi), trajectory, status)
  end subroutine run_whole

  !> What will be computed and what is skipped, with the reasons.
  function plan_polynomial(job, system, load, reach) result(text)
    type(transient_job), intent(in) :: job
    type(polynomial_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Latest time of any run that goes on from this one, for which kernels are fitted.
    real(wp), intent(in), optional :: reach
    character(len=:), allocatable :: text
    real(wp) :: step, last

    step = 0.0_wp
    if (job%dt > 0.0_wp) step = job%t_end/first_steps(job, 0.0_wp)
    last = furthest*job%t_end
    if (present(reach)) last = reach
    text = 'skips: memory (no kernels)'
    if (count_hidden(system) > 0) text = 'computes: memory by '//things(count_hidden(system), &
                                                                        'exponential')
    if (needs_fit(system)) text = tell_fit(system, step, last)
    text = plan_transient(job)//text//new_line('a') &
           //tell_idle(moved_coordinates(system, driven(job, system, load))) &
           //tell_laws(system)//tell_zeros(system, load)
  end function plan_polynomial

end module viscovib_polynomial_job
