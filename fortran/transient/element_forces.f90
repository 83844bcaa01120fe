! Optimize: -O2
!> Forces of springs and dampers along a motion that is known: of the elements of a structure, of
!! the springs of a polynomial system, and of the springs of a mount.
!!
!! The force opposite to a deflection d has three parts: k d + g(d, d') without memory, c d', and
!! the reduction of the first by relaxation, -R * (k d + g).
module viscovib_element_forces
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan, ieee_quiet_nan, ieee_value
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_law_term, only: law_term
  use viscovib_motion_balance, only: recall
  use viscovib_mount, only: mount_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_structure_elements, only: element_type
  implicit none
  private

  public :: element_forces_type, find_element_forces, find_forces_by_kernel, find_mount_springs, &
    sampled_motion, spring_force

  !> A motion relative to the base.
  type :: sampled_motion
    !> Times, ascending; coordinates and rates at these, shape (n, n_dof).
    real(wp), allocatable :: times(:), u(:, :), rate(:, :)
    !> The motion until then as of `recalled_along`, with the displacement before it; not
    !! allocated: no force remembers it.
    real(wp), allocatable :: ends(:), panel_u(:, :), panel_rate(:, :), held(:)
    !> Forces of laws as the run has them, at the times and on the panels, a column for each law.
    !! NaN, or not allocated: a law gives its force itself; an element with a state has none.
    real(wp), allocatable :: laws(:, :), panel_laws(:, :)
  end type sampled_motion

  type :: element_forces_type
    !> Deflections relative to the base, rates, and the parts of the forces, shape (n, m).
    real(wp), allocatable :: deflection(:, :), rate(:, :), elastic(:, :), damping(:, :)
    real(wp), allocatable :: memory(:, :)
  contains
    procedure :: force
  end type element_forces_type

contains

  !> Forces opposite to the deflections, shape (n, m).
  pure function force(self)
    class(element_forces_type), intent(in) :: self
    real(wp) :: force(size(self%elastic, 1), size(self%elastic, 2))
    force = self%elastic + self%damping + self%memory
  end function force

  !> Forces of elements of a structure.
  subroutine find_element_forces(elements, kernels, motion, forces, moved)
    !> With directions of all coordinates of the motion.
    type(element_type), intent(in) :: elements(:)
    type(kernel_holder), intent(in) :: kernels(:)
    type(sampled_motion), intent(in) :: motion
    type(element_forces_type), intent(out) :: forces
    !> Displacements, velocities and accelerations of supports that move each on its own, shape
    !! (n, n_supports, 3).
    real(wp), intent(in), optional :: moved(:, :, :)
    type(sampled_motion) :: seen
    real(wp) :: rows(size(motion%u, 2), size(elements))
    integer :: j

    do j = 1, size(elements)
      rows(:, j) = elements(j)%direction
    end do
    seen%u = along(rows, motion%u)
    seen%rate = along(rows, motion%rate)
    if (allocated(motion%laws)) seen%laws = motion%laws
    if (allocated(motion%ends)) then
      seen%times = motion%times
      seen%ends = motion%ends
      seen%panel_u = along(rows, motion%panel_u)
      seen%panel_rate = along(rows, motion%panel_rate)
      if (allocated(motion%panel_laws)) seen%panel_laws = motion%panel_laws
      seen%held = matmul(motion%held, rows)
    end if
    do j = 1, size(elements)
      if (.not. (present(moved) .and. allocated(elements(j)%ends))) cycle
      seen%u(:, j) = seen%u(:, j) + matmul(moved(:, :, 1), elements(j)%ends)
      seen%rate(:, j) = seen%rate(:, j) + matmul(moved(:, :, 2), elements(j)%ends)
    end do
    call find_parts(elements, kernels, seen, forces)
    do j = 1, size(elements)
      associate (k => elements(j)%series(1), r => elements(j)%series(4))
        if (.not. k > 0.0_wp) cycle
        forces%elastic(:, j) = k*(seen%rate(:, j) + r*seen%u(:, j))
        forces%damping(:, j) = 0.0_wp
        forces%deflection(:, j) = matmul(motion%u, elements(j)%across)
        forces%rate(:, j) = matmul(motion%rate, elements(j)%across)
      end associate
    end do
  end subroutine find_element_forces

  !> Deflections along directions (n_dof, m), most of whose entries are 0, shape (n, m).
  pure function along(directions, u) result(d)
    real(wp), intent(in) :: directions(:, :), u(:, :)
    real(wp) :: d(size(u, 1), size(directions, 2))
    integer :: i, j
    d = 0.0_wp
    do j = 1, size(d, 2)
      do i = 1, size(u, 2)
        if (abs(directions(i, j)) > 0.0_wp) d(:, j) = d(:, j) + directions(i, j)*u(:, i)
      end do
    end do
  end function along

  !> Forces of the springs in x and phi of a mount. Its damping matrix is no part of them.
  subroutine find_mount_springs(mount, motion, forces)
    type(mount_type), intent(in) :: mount
    type(sampled_motion), intent(in) :: motion
    type(element_forces_type), intent(out) :: forces
    type(element_type) :: springs(2)
    type(sampled_motion) :: seen
    real(wp) :: still(1, 2), d(1, 2), none(1, 2)
    integer :: j

    springs%stiffness = [mount%parameters%stiffness_x, mount%parameters%stiffness_phi]
    springs%kernel = [mount%parameters%kernel_x, mount%parameters%kernel_phi]
    do j = 1, 2
      allocate (springs(j)%laws(0))
    end do
    seen = motion
    call mount%deflect(motion%u, motion%rate, seen%u, seen%rate)
    if (allocated(motion%ends)) then
      call mount%deflect(motion%panel_u, motion%panel_rate, seen%panel_u, seen%panel_rate)
      still(1, :) = motion%held
      call mount%deflect(still, 0.0_wp*still, d, none)
      seen%held = d(1, :)
    end if
    call find_parts(springs, mount%kernels, seen, forces)
  end subroutine find_mount_springs

  !> Forces on each coordinate of the springs and laws with a kernel; without `kernel`, of all. The
  !! damping matrix belongs to those without memory.
  subroutine find_forces_by_kernel(system, motion, forces, kernel)
    type(polynomial_type), intent(in) :: system
    type(sampled_motion), intent(in) :: motion
    type(element_forces_type), intent(out) :: forces
    integer, intent(in), optional :: kernel
    real(wp), allocatable :: w(:, :), held(:, :), recalled(:, :), onto(:, :)
    integer :: j

    onto = transpose(system%spread)
    allocate (forces%damping, mold=motion%u)
    forces%damping = 0.0_wp
    if (.not. present(kernel)) then
      forces%damping = matmul(motion%rate, transpose(system%damping))
    else
      do j = 1, size(onto, 1)
        if (system%kernel_of(j) /= kernel) onto(j, :) = 0.0_wp
      end do
      if (kernel == 0) forces%damping = matmul(motion%rate, transpose(system%damping))
    end if
    forces%deflection = motion%u
    forces%rate = motion%rate
    call find_variables(system, motion%u, motion%rate, motion%laws, w)
    forces%elastic = matmul(w, onto)
    allocate (recalled(size(motion%u, 1), size(w, 2)), source=0.0_wp)
    if (allocated(motion%ends)) then
      call find_variables(system, motion%panel_u, motion%panel_rate, motion%panel_laws, w)
      held = spread(motion%held, 1, 1)
      call recall_variables()
    end if
    forces%memory = -matmul(recalled, onto)

  contains

    subroutine recall_variables()
      real(wp), allocatable :: first(:, :), none(:, :)
      call find_variables(system, held, 0.0_wp*held, none, first)
      call recall(system%kernels, system%kernel_of, motion%ends, w, first(1, :), motion%times, &
                  recalled)
    end subroutine recall_variables

  end subroutine find_forces_by_kernel

  !> Hereditary variables of a polynomial system at states, with forces of laws that are known.
  subroutine find_variables(system, u, rate, known, w)
    type(polynomial_type), intent(in) :: system
    real(wp), intent(in) :: u(:, :), rate(:, :)
    !> As of `sampled_motion`.
    real(wp), allocatable, intent(in) :: known(:, :)
    real(wp), allocatable, intent(out) :: w(:, :)
    real(wp), allocatable :: seen(:, :), bend(:, :)
    real(wp) :: value(size(u, 1))
    integer :: i, j

    w = matmul(u, transpose(system%gather))
    allocate (seen(size(u, 1), size(u, 2) + system%n_rates()))
    seen(:, :size(u, 2)) = u
    do j = 1, system%n_rates()
      seen(:, size(u, 2) + j) = rate(:, system%rates(j))
    end do
    allocate (bend(size(w, 1), size(w, 2)), source=0.0_wp)
    call system%sampled_remainder(seen, bend)
    w = w + bend
    do i = 1, size(system%laws)
      associate (law => system%laws(i))
        ! The remainder contains laws that are polynomials.
        if (law%degree > 0) cycle
        call find_law_force(law, matmul(seen, transpose(law%seen)), known, i, value)
        do j = 1, size(law%variables)
          w(:, law%variables(j)) = w(:, law%variables(j)) + law%weights(j)*value
        end do
      end associate
    end do
  end subroutine find_variables

  !> Parts of forces along deflections, which are the coordinates of a motion.
  subroutine find_parts(elements, kernels, motion, forces)
    type(element_type), intent(in) :: elements(:)
    type(kernel_holder), intent(in) :: kernels(:)
    type(sampled_motion), intent(in) :: motion
    type(element_forces_type), intent(out) :: forces
    real(wp), allocatable :: panels(:, :), first(:, :), none(:, :)
    integer :: j

    forces%deflection = motion%u
    forces%rate = motion%rate
    call find_elastic(elements, motion%u, motion%rate, motion%laws, forces%elastic)
    allocate (forces%damping, forces%memory, mold=motion%u)
    do j = 1, size(elements)
      forces%damping(:, j) = elements(j)%damping*motion%rate(:, j)
    end do
    forces%memory = 0.0_wp
    if (.not. (allocated(motion%ends) .and. any(elements%kernel > 0))) return
    call find_elastic(elements, motion%panel_u, motion%panel_rate, motion%panel_laws, panels)
    call find_elastic(elements, spread(motion%held, 1, 1), 0.0_wp*spread(motion%held, 1, 1), none, &
                      first)
    call recall(kernels, elements%kernel, motion%ends, panels, first(1, :), motion%times, &
                forces%memory)
    forces%memory = -forces%memory
  end subroutine find_parts

  !> k d + g(d, d') of each element.
  subroutine find_elastic(elements, d, speed, known, elastic)
    type(element_type), intent(in) :: elements(:)
    !> Shape (n, m).
    real(wp), intent(in) :: d(:, :), speed(:, :)
    real(wp), allocatable, intent(in) :: known(:, :)
    real(wp), allocatable, intent(out) :: elastic(:, :)
    real(wp) :: value(size(d, 1)), arguments(size(d, 1), 2)
    integer :: i, j, k, n, top

    allocate (elastic(size(d, 1), size(d, 2)), source=0.0_wp)
    n = 0
    do j = 1, size(elements)
      associate (one => elements(j))
        ! The force of an element with a state contains its stiffness.
        if (.not. any(one%laws%state > 0)) then
          top = findloc(abs(one%powers) > 0.0_wp, .true., 1, back=.true.) + 1
          elastic(:, j) = spring_force(one%stiffness, one%powers(2:top), d(:, j))
        end if
        do i = 1, size(one%laws)
          n = n + 1
          associate (law => one%laws(i))
            do k = 1, size(law%rates)
              arguments(:, k) = law%arguments(k, 1)*d(:, j) + law%rates(k, 1)*speed(:, j)
            end do
            call find_law_force(law, arguments(:, :size(law%rates)), known, n, value)
            elastic(:, j) = elastic(:, j) + value
          end associate
        end do
      end associate
    end do
  end subroutine find_elastic

  !> Force of a law as the run has it, else by its arguments, shape (n, n_arguments).
  subroutine find_law_force(law, arguments, known, place, force)
    type(law_term), intent(in) :: law
    real(wp), intent(in) :: arguments(:, :)
    real(wp), allocatable, intent(in) :: known(:, :)
    !> Its column.
    integer, intent(in) :: place
    real(wp), intent(out) :: force(:)
    real(wp) :: given(size(force))

    given = ieee_value(0.0_wp, ieee_quiet_nan)
    if (allocated(known)) given = known(:, place)
    force = 0.0_wp
    if (law%state == 0 .and. any(ieee_is_nan(given))) call law%program%evaluate(arguments, force)
    where (.not. ieee_is_nan(given)) force = given
  end subroutine find_law_force

  !> k d + c_2 d^2 + c_3 d^3 + ...
  pure function spring_force(stiffness, coefficient, d) result(force)
    real(wp), intent(in) :: stiffness, coefficient(:), d(:)
    real(wp) :: force(size(d))
    integer :: power
    force = 0.0_wp
    do power = size(coefficient), 1, -1
      force = (force + coefficient(power))*d
    end do
    force = (stiffness + force)*d
  end function spring_force

end module viscovib_element_forces
