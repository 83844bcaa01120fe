!> Elements with states in a harmonic balance: their forces at the samples of a cycle, and how these
!! move with each basic motion.
module viscovib_loop_samples
  use viscovib_friction_loop, only: friction_loop, run_loop
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial, only: polynomial_type
  implicit none
  private

  public :: add_loops, has_other_states, has_states, loop_block, loops_of

contains

  !> The elements of a system that have states.
  pure function loops_of(system) result(loops)
    class(oscillator_type), intent(in) :: system
    type(friction_loop), allocatable :: loops(:)
    integer, allocatable :: places(:)
    integer :: i

    allocate (places(0))
    select type (system)
    class is (polynomial_type)
      places = pack([(i, i=1, size(system%laws))], system%laws%state > 0)
    end select
    allocate (loops(size(places)))
    do i = 1, size(places)
      loops(i)%law = places(i)
    end do
  end function loops_of

  pure logical function has_states(system)
    class(oscillator_type), intent(in) :: system
    has_states = .false.
    select type (system)
    class is (polynomial_type)
      has_states = any(system%laws%state > 0)
    end select
  end function has_states

  !> Elements that are not run here.
  pure logical function has_other_states(system)
    class(oscillator_type), intent(in) :: system
    integer :: i
    has_other_states = .false.
    select type (system)
    class is (polynomial_type)
      has_other_states = any(system%laws%state > 1)
      do i = 1, size(system%laws)
        if (system%laws(i)%state == 0) cycle
        has_other_states = has_other_states .or. size(system%laws(i)%program%number) > 3
      end do
    end select
  end function has_other_states

  !> Add their forces, without the linear part, to the variables in which they stand.
  subroutine add_loops(loops, system, set, u, w)
    type(friction_loop), intent(inout) :: loops(:)
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    !> Samples of coordinates and of variables; behind the last sample rows may be filled up.
    real(wp), intent(in) :: u(:, :)
    real(wp), intent(inout) :: w(:, :)
    real(wp) :: force(set%n_samples)
    integer :: i, j, n

    n = set%n_samples
    select type (system)
    class is (polynomial_type)
      do i = 1, size(loops)
        associate (law => system%laws(loops(i)%law))
          call run_loop(loops(i), matmul(u(:n, :size(law%arguments, 2)), law%arguments(1, :)), &
                        set%half_wave, law%program%number(2), law%program%number(3), force)
          do j = 1, size(law%variables)
            w(:n, law%variables(j)) = w(:n, law%variables(j)) + law%weights(j)*force
          end do
        end associate
      end do
    end select
  end subroutine add_loops

  !> How the force of one moves with a motion of its deflection, and the factors of that on the
  !! equation of each coordinate by each coordinate.
  subroutine loop_block(loop, system, motion, samples, factors)
    type(friction_loop), intent(in) :: loop
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: motion(:)
    real(wp), intent(out) :: samples(:), factors(:, :)
    integer :: b, j, s

    samples = 0.0_wp
    factors = 0.0_wp
    select type (system)
    class is (polynomial_type)
      associate (law => system%laws(loop%law))
        do s = 1, size(motion)
          if (loop%slid(s) == 0) cycle
          samples(s) = -law%program%number(2)*loop%turned(s)*motion(loop%slid(s))
        end do
        do b = 1, size(factors, 2)
          do j = 1, size(law%variables)
            factors(:, b) = factors(:, b) + system%spread(:, law%variables(j)) &
                            *(law%weights(j)*law%arguments(1, b))
          end do
        end do
      end associate
    end select
  end subroutine loop_block

end module viscovib_loop_samples
