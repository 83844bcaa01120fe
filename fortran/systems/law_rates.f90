!> Time scales of force laws, such as the contact stiffness, that limit the step size.
module viscovib_law_rates
  use viscovib_kinds, only: wp
  use viscovib_law_program, only: wall
  use viscovib_law_term, only: law_term
  use viscovib_moving_element, only: fastest_settling, moving_element
  implicit none
  private

  public :: part_by_laws

  !> Largest angle of the fastest motion within a substep (a quarter turn), and its lower bound for
  !! short steps; shortest substep as a fraction of the step.
  real(wp), parameter :: most = 1.57_wp, least = most/32.0_wp, shortest = 1.0_wp/4096.0_wp

contains

  !> Longest substep allowed by the laws. The angle turned within it is at most that of the linear
  !! subsystem in a step. `thin`: ratio of this step size to the longest step size of the compared
  !! runs; the substeps are shorter by the same ratio.
  pure real(wp) function part_by_laws(laws, inverse, rate, h, thin, q, v, elements) &
    result(longest)
    type(law_term), intent(in) :: laws(:)
    !> M^(-1); rate of the linear subsystem and step size; states, shape (n, n_dof).
    real(wp), intent(in) :: inverse(:, :), rate, h, thin, q(:, :), v(:, :)
    !> Their states relax at rates that add to the rates of forces.
    type(moving_element), intent(in) :: elements(:)
    real(wp) :: angle, fastest
    angle = thin*max(least, min(most, rate*h/thin))
    fastest = fastest_of_laws(laws, inverse, q, v) + fastest_settling(elements, q, v)
    longest = max(angle/max(fastest, tiny(1.0_wp)), shortest*h)
  end function part_by_laws

  !> Upper bound of the rates of laws over all given states, from their slopes f_q and f_v: the
  !! square root of the sum of |M^(-1) w f_q|, plus the sum of |M^(-1) w f_v|.
  pure real(wp) function fastest_of_laws(laws, inverse, q, v) result(fastest)
    type(law_term), intent(in) :: laws(:)
    !> M^(-1); states, shape (n, n_dof).
    real(wp), intent(in) :: inverse(:, :), q(:, :), v(:, :)
    real(wp) :: square(size(q, 1)), rate(size(q, 1)), value(size(q, 1)), weight
    integer :: i, k

    square = 0.0_wp
    rate = 0.0_wp
    do i = 1, size(laws)
      associate (law => laws(i))
        block
          real(wp) :: slopes(size(q, 1), size(law%arguments, 1))
          weight = sum(abs(matmul(inverse(:, law%equations), law%weights)))
          call law%program%differentiate(matmul(q, transpose(law%arguments)) &
                                         + matmul(v, transpose(law%rates)), value, slopes)
          slopes = min(abs(slopes), sqrt(wall))
          do k = 1, size(slopes, 2)
            square = square + weight*sum(abs(law%arguments(k, :)))*slopes(:, k)
            rate = rate + weight*sum(abs(law%rates(k, :)))*slopes(:, k)
          end do
        end block
      end associate
    end do
    fastest = maxval(sqrt(square) + rate)
  end function fastest_of_laws

end module viscovib_law_rates
